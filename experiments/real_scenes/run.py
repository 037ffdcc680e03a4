"""The scenes of a folder: which of them load, and do their pictures agree with Mitsuba's?

Each scene is loaded and rendered in a process of its own, with a time limit. Outcomes are `strict` (it loads as it is,
maybe with warnings of things that change nothing), `left out` (it loads without what is not supported), and `refused`.
"""

import argparse
import json
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from experiments.common import ROOT

PATTERNS = ("*.xml", "*.gltf", "*.glb")
LONGEST_SIDE = 48  # pixels
FINITE = {True: "finite", False: "NOT FINITE"}  # where there is no picture to compare with
DEEP = 12  # segments, where Mitsuba counts them in another way


def find(folder):
    """Scene files below a folder; XML files that are parts of others are told by their outermost element."""
    paths = sorted(path for pattern in PATTERNS for path in Path(folder).rglob(pattern))
    return [path for path in paths if path.suffix != ".xml" or b"<scene" in path.read_bytes()]


def load(path, found):
    """The scene, or None, by jaxdr; what happened goes into `found`."""
    import jaxdr as jd

    read = jd.load_mitsuba if path.suffix == ".xml" else jd.load_gltf
    scene = None
    for outcome, options in (("strict", {}), ("left out", {"ignore_unsupported": True})):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            started = time.perf_counter()
            try:
                scene = read(path, **options)
            except ValueError as error:
                found["error"] = str(error)
            found["seconds"] = round(time.perf_counter() - started, 2)
        if scene is not None:
            found.update(outcome=outcome, warnings=sorted({str(warning.message) for warning in caught}))
            return scene
    found.update(outcome="refused")
    return None


def small(scene, spp, depth):
    """Two independent pictures of a scene, with its film made small."""
    import equinox as eqx
    import jax

    import jaxdr as jd
    from jaxdr.program_cache import keep_programs

    keep_programs(ROOT / "runs/real_scenes")  # most scenes of a corpus differ in numbers alone

    film = scene.camera.film
    width, height = film.width, film.height
    share = min(1.0, LONGEST_SIDE / max(width, height))
    tiny = jd.Film(max(1, round(width * share)), max(1, round(height * share)), jd.Box())
    scene = eqx.tree_at(lambda s: s.camera.film, scene, tiny)
    integrator = jd.PathTracer(max_depth=depth, boundary=None)
    return [jd.render(scene, jax.random.key(seed), spp=spp, integrator=integrator) for seed in (0, 1)], tiny


def measure(path, spp, depth):
    """What is known of one scene."""
    found = {"scene": path.name}
    scene = load(path, found)
    theirs = None
    if path.suffix == ".xml":
        import mitsuba as mi

        mi.set_variant("scalar_rgb")
        mi.set_log_level(mi.LogLevel.Error)
        started = time.perf_counter()
        try:
            theirs = mi.load_file(str(path))
        except RuntimeError as error:
            found["mitsuba"] = str(error)[-300:]
        found["mitsuba_seconds"] = round(time.perf_counter() - started, 2)
    if scene is None or spp == 0:
        return found
    # Of surfaces that rays pass through, Mitsuba's `path` counts each as a bounce and gives 2 % too little; `volpath`
    # counts them where a light is sampled. At this depth no counting matters.
    passable = theirs is not None and any(_lets_pass(shape) for shape in theirs.shapes())
    kind, depth = ("volpath", max(depth, DEEP)) if passable else ("path", depth)
    ours, tiny = small(scene, spp, depth)
    ours = np.asarray(ours)
    found["finite"] = bool(np.isfinite(ours).all())
    found["mean"] = ours.mean(axis=(0, 1, 2)).tolist()
    if theirs is None:
        return found
    reference = pictures_by_mitsuba(path, tiny, spp, {"type": kind, "max_depth": depth})
    found["ratio"] = (ours.mean(axis=(0, 1, 2)) / reference.mean(axis=(0, 1, 2))).round(3).tolist()
    # Half the difference of two pictures has the variance of their mean.
    noise = ((ours[0] - ours[1]) ** 2 + (reference[0] - reference[1]) ** 2) / 4
    error = (ours.mean(0) - reference.mean(0)) ** 2
    found["error_over_noise"] = round(float(np.sqrt(error.mean() / noise.mean())), 2) if noise.mean() > 0 else None
    return found


def pictures_by_mitsuba(path, tiny, spp, integrator):
    """Two independent pictures of the file with a film of the same size and a box filter."""
    import mitsuba as mi

    mi.file_resolver().append(str(path.parent.resolve()))  # as `load_file` does
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(path))
    mi.parser.transform_all(config, state)
    film = {"width": tiny.width, "height": tiny.height, "rfilter": mi.load_dict({"type": "box"})}
    for node in state.nodes:
        if node.type == mi.ObjectType.Film:
            for name in list(node.props.keys()):
                if name.startswith("crop_") or not isinstance(node.props[name], str | int | float):  # a filter inside
                    del node.props[name]
            for name, value in film.items():
                node.props[name] = value
    scene = mi.parser.instantiate(config, state)
    scene = scene[0] if isinstance(scene, list) else scene
    integrator = mi.load_dict(integrator)
    return np.asarray([np.asarray(mi.render(scene, integrator=integrator, spp=spp, seed=s))[..., :3] for s in (2, 3)])


def _lets_pass(shape):
    """Whether rays go through a shape of Mitsuba's as if it were not there, or there is a medium in it."""
    import mitsuba as mi

    return mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null) or shape.is_medium_transition()


def row(found):
    """A line of the table."""
    ratio = found.get("ratio")
    cells = [
        found["scene"],
        found.get("outcome", found.get("failed", "?")),
        str(len(found.get("warnings", []))),
        " ".join(f"{value:.3f}" for value in ratio) if ratio else FINITE.get(found.get("finite"), ""),
        str(found.get("error_over_noise", "")),
        f"{found['seconds']:.2f}" if "seconds" in found else "",
        "refused" if "mitsuba" in found else f"{found['mitsuba_seconds']:.2f}" if "mitsuba_seconds" in found else "",
    ]
    return f"| {' | '.join(cells)} |"


def table(everything):
    """Markdown: counts, then a line for each scene, then why scenes are refused or something is left out."""
    counts = {}
    for found in everything:
        outcome = found.get("outcome", found.get("failed", "?"))
        counts[outcome] = counts.get(outcome, 0) + 1
    lines = ["; ".join(f"{outcome}: {count}" for outcome, count in sorted(counts.items())), ""]
    lines += ["| scene | outcome | warnings | ratio of means (RGB) | error / noise | loading (s) | Mitsuba (s) |"]
    lines += ["| --- " * 7 + "|", *map(row, everything), ""]
    for found in everything:
        if "error" in found:
            reason = found["error"].splitlines()
            lines.append(f"- {found['scene']}: {' '.join(part.strip() for part in reason)}")
    return "\n".join(lines) + "\n"


def main():
    """Measure every scene in a process of its own and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="folder of scenes, or with --one a scene")
    parser.add_argument("--one", action="store_true", help="measure this scene here and print JSON")
    parser.add_argument("--spp", type=int, default=64, help="samples of each of two pictures; 0 only loads")
    parser.add_argument("--depth", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=300, help="time limit of a scene")
    parser.add_argument("--name", default="scenes", help="of the table in results/")
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.folder, options.spp, options.depth)))
        return
    everything = []
    for path in find(options.folder):
        command = [sys.executable, "-m", "experiments.real_scenes.run", "--one", str(path)]
        command += ["--spp", str(options.spp), "--depth", str(options.depth)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=options.seconds, check=True)
            found = json.loads(done.stdout.splitlines()[-1])
        except subprocess.TimeoutExpired:
            found = {"scene": path.name, "failed": "out of time"}
        except subprocess.CalledProcessError as error:
            found = {"scene": path.name, "failed": "crash", "error": error.stderr[-500:]}
        text = json.dumps(found).replace(f"{path.parent}/", "")
        everything.append(json.loads(text))
        print(row(everything[-1]), flush=True)
        folder = ROOT / "experiments/real_scenes/results"
        folder.mkdir(exist_ok=True)
        (folder / f"{options.name}.json").write_text(json.dumps(everything, indent=1))
        (folder / f"{options.name}.md").write_text(table(everything))


if __name__ == "__main__":
    main()
