"""Forward paths per second of jaxdr and of Mitsuba's `path` (LLVM) on four scenes, in turns in one process.

python -m experiments.forward_cost.run --profile
"""

import statistics
import time

import numpy as np

from experiments import common
from experiments.forward_cost.scenes import scenes
from experiments.forward_images import files, peer

STUDY = "forward_cost"
COLUMNS = {
    "scene": ("scene", ""),
    "triangles": ("triangles", ",d"),
    "jaxdr, Mpaths/s": ("ours", ".2f"),
    "Mitsuba, Mpaths/s": ("theirs", ".2f"),
    "jaxdr / Mitsuba": ("ratio", ".3f"),
    "least": ("least", ".3f"),
    "most": ("most", ".3f"),
    "jaxdr compiles, s": ("compile", ".1f"),
    "Mitsuba's first call, s": ("first", ".1f"),
    "brightness, jaxdr / Mitsuba": ("brightness", ".4f"),
}
PROFILE = {"piece": ("piece", ""), "s / million paths": ("seconds", ".3f"), "share": ("share", ".0%")}


def measure(path, case, size, spp, rounds, profile):
    """The row of a scene, and the profile's rows; a process of its own."""
    import jax
    import mitsuba as mi

    import jaxdr as jd

    scene = jd.load_mitsuba(path)
    tracer = jd.PathTracer(max_depth=case.max_depth, boundary=None)
    start = time.perf_counter()
    program = jd.jit(lambda scene, key: jd.render(scene, key, spp, tracer)).lower(scene, jax.random.key(0)).compile()
    row = {"compile": time.perf_counter() - start}
    row["triangles"] = sum(len(shape.mesh.faces) for shape in scene.shapes.values())

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    theirs = mi.load_file(str(peer.tessellated(path, scene)))

    def mitsuba(seed):
        begun = time.perf_counter()
        image = np.array(mi.render(theirs, spp=spp, seed=seed))  # copying it waits for it
        return image, time.perf_counter() - begun

    row["first"] = mitsuba(0)[1]
    common.seconds_of(program, scene, jax.random.key(0))
    images, pairs = ([], []), []
    for i in range(1, rounds + 1):
        mine, seconds = common.seconds_of(program, scene, jax.random.key(i))
        other, their_seconds = mitsuba(i)
        pairs.append((seconds, their_seconds))
        images[0].append(np.asarray(mine).mean())
        images[1].append(other.mean())
    paths = size * size * spp / 1e6
    ratios = [b / a for a, b in pairs]
    row |= {
        "ours": paths / statistics.median(a for a, _ in pairs),
        "theirs": paths / statistics.median(b for _, b in pairs),
    }
    row |= {"ratio": statistics.median(ratios), "least": min(ratios), "most": max(ratios), "pairs": pairs}
    row["brightness"] = float(np.mean(images[0]) / np.mean(images[1]))
    if not profile:
        return row, [], 0.0
    from experiments.forward_cost.profile import report

    samples = max(1, tracer.paths_at_once(differentiated=False) // (size * size))
    return row, *report(scene, tracer.settings, samples)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--profile", action="store_true", help="also take a bounce apart")
    options = parser.parse_args()
    size, spp, rounds = (32, 16, 2) if options.quick else (128, 64, 5)
    folder, work = common.results(STUDY, options.quick), common.scratch(STUDY) / "scenes"
    work.mkdir(exist_ok=True)
    files.write_files(work)
    rows, profiles, text = [], {}, []
    for name, case in scenes(size).items():
        path = work / f"{name.replace(' ', '_')}.xml"
        path.write_text(case.xml)
        row, profile, vertices = common.in_fresh_process(measure, path, case, size, spp, rounds, options.profile)
        rows.append({"scene": name, "max_depth": case.max_depth, **row})
        print(f"{name}: {row['ours']:.2f} Mpaths/s, {row['ratio']:.3f} of Mitsuba's", flush=True)
        if profile:
            profiles[name] = {"rows": profile, "vertices": vertices}
            text += [f"### {name}", "", common.table(profile, PROFILE), ""]
            text += [f"A path has {vertices:.2f} vertices that scatter.", ""]
    report = "\n".join([common.table(rows, COLUMNS), "", *text])
    print("\n" + report)
    (folder / "table.md").write_text(report)
    common.write_json(folder / "forward_cost.json", {"rows": rows, "profiles": profiles, "size": size, "spp": spp})


if __name__ == "__main__":
    main()
