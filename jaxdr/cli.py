"""Command line: `jaxdr render`, `gradient`, `plan`, `optimize`, `cameras`, `reconstruct`, `chart`, `view`.

Compiled programs are kept in the user's cache folder. Each command that compiles says so first, in a line on stderr.

After a user's mistake a command prints one line on stderr, `jaxdr: error: …` (and a line for each item of a list of
problems). It ends with exit code 2, before anything is written. A run whose disk is full or gone ends the same way, and
its last checkpoint is intact. A run that meets NaN ends with exit code 1. Ctrl-C and SIGTERM end a run with 130.
"""

import argparse
import contextlib
import json
import shlex
import sys
import warnings
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr import __version__
from jaxdr.aovs import NAMES, render_aovs
from jaxdr.boundary import ESTIMATORS
from jaxdr.boundary.named import OUTSIDE, estimator_class
from jaxdr.chart.config import chart_config
from jaxdr.chart.figure import require_matplotlib
from jaxdr.chart.run import chart
from jaxdr.compilation import jit
from jaxdr.image_formats.exr import is_available as has_openexr
from jaxdr.images import SUFFIXES, check_image_path, save_png, signed_picture, write_image
from jaxdr.integrators import INTEGRATORS, Integrator, PathTracer
from jaxdr.integrators.choice import choose
from jaxdr.optimize.compare import compare, is_comparison, variants
from jaxdr.optimize.config import optimize_config
from jaxdr.optimize.heartbeat import working
from jaxdr.optimize.processes import ProcessLost, leave_at_once, start_processes
from jaxdr.optimize.progress import Interrupted, NotFinite, Progress, Stopped
from jaxdr.optimize.reconstruction.config import QUALITIES, reconstruct_config
from jaxdr.optimize.reconstruction.found_cameras import find_cameras_with_bars
from jaxdr.optimize.reconstruction.reconstruct import reconstruct
from jaxdr.optimize.recovery.config import RecoveryConfig, is_recovery, recovery_config
from jaxdr.optimize.recovery.recover import recover
from jaxdr.optimize.shape import optimize
from jaxdr.optimize.strict_toml import override_table, read_toml, split_assignment
from jaxdr.plan.directions import moving_along
from jaxdr.plan.plan import DEPTH_TOLERANCE, MEASURED, plan
from jaxdr.program_cache import keep_programs, leave_out, user_folder
from jaxdr.render import render
from jaxdr.scene.formats.gltf.load import is_gltf, load_gltf
from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.formats.mitsuba.settings import RenderSettings, mitsuba_settings
from jaxdr.scene.motion import motion
from jaxdr.scene.scene import Scene, every_parameter
from jaxdr.view.write import NAME as PAGE_NAME
from jaxdr.view.write import write_page
from jaxdr.views.registration import report

ERROR, FAILED, INTERRUPTED = 2, 1, 130
SAMPLES, MAX_DEPTH = 64, 3
DEEPEST = 16  # upper limit of segments that a file can ask for, because there is no Russian roulette
PASS = 1 << 24  # paths of an image between two steps of the progress bar


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit code; `arguments` default to those of the process."""
    try:
        options = _parser().parse_args(arguments)
        if options.divides:
            _start_devices(options)
        if options.compiles:
            _keep_programs(options)
        return options.command(options)
    except (_UsageError, ValueError, OSError, ImportError) as problem:
        if "options" in locals() and options.debug:
            raise
        return _complain(problem, ERROR)
    except NotFinite as problem:
        return _complain(problem, FAILED)
    except ProcessLost as problem:
        leave_at_once(_complain(problem, FAILED))
    except Interrupted as problem:
        print(f"jaxdr: {problem}", file=sys.stderr)
        return INTERRUPTED
    except KeyboardInterrupt:
        print("jaxdr: interrupted", file=sys.stderr)
        return INTERRUPTED


def _start_devices(options) -> None:
    """Divide the processor into so many devices (no effect on GPUs), and join the other processes of the run."""
    if options.devices is not None:
        jax.config.update("jax_num_cpu_devices", options.devices)
    named = (options.coordinator, options.processes, options.process)
    if any(value is not None for value in named) or options.distributed:
        start_processes(*named)


def _keep_programs(options) -> None:
    """Keep compiled programs for the next command, unless the user does not want it or the folder can't be used."""
    if options.no_cache:
        leave_out()
        return
    try:
        folder = keep_programs(user_folder() / "programs")
    except OSError as problem:
        print(f"jaxdr: warning: compiled programs are not kept: {problem}", file=sys.stderr)
    else:
        print(f"jaxdr: compiled programs are kept in {folder} (--no-cache leaves that out)", file=sys.stderr)


def _render(options) -> int:
    output, key = Path(options.output), jax.random.key(options.seed)
    aovs = {name: _aov_path(output, name) for name in options.aov}
    for path in (output, *aovs.values()):
        check_image_path(path)
    scene = _load_scene(options)
    spp, depth = _settings(options)
    with working(f"{output}: compiling and rendering"):
        image = _finite(_in_passes(scene, key, spp, INTEGRATORS[options.integrator](max_depth=depth, boundary=None)))
        found = render_aovs(scene, key, spp=spp, names=aovs) if aovs else {}
    found = {name: _finite(values.reshape(*values.shape[:2], -1)) for name, values in found.items()}
    for path, values in ((output, image), *((aovs[name], values) for name, values in found.items())):
        write_image(path, values)
        print(path)
    return 0


def _settings(options) -> tuple[int, int]:
    """(samples per pixel, longest path in segments) from the options, else from the file, else the defaults."""
    path = Path(options.scene)
    asked = RenderSettings(None, None) if is_gltf(path) else mitsuba_settings(path, **_variables(options))
    depth = options.max_depth or asked.max_depth or MAX_DEPTH
    if not options.max_depth and not 0 < depth <= DEEPEST:
        wanted = "without an end" if depth < 0 else f"of {depth} segments"
        print(f"jaxdr: {path} asks for paths {wanted}; {DEEPEST} segments are traced (--max-depth)", file=sys.stderr)
        depth = DEEPEST
    return options.spp or asked.spp or SAMPLES, depth


def _in_passes(scene: Scene, key, spp: int, tracer: Integrator) -> np.ndarray:
    """The image. If it has many paths, it is the mean of several images, with a progress bar."""
    film = scene.camera.film
    each = min(spp, max(1, PASS // (film.width * film.height)))
    counts = [each] * (spp // each) + ([spp % each] if spp % each else [])
    # The scene is an argument, because XLA would spend a long time on folding constants.
    image = jit(lambda scene, key, spp: render(scene, key, spp=spp, integrator=tracer), static_argnums=2)
    if len(counts) == 1:
        return np.asarray(image(scene, key, spp))
    total = 0.0
    with Progress("render", len(counts)) as progress:
        progress.preparing("compiling")
        for i, count in enumerate(counts):
            total = total + np.asarray(image(scene, jax.random.fold_in(key, i), count), np.float64) * (count / spp)
            progress.step()
    return np.asarray(total, np.float32)


def _aov_path(output: Path, name: str) -> Path:
    """A path beside the image, in the same format if that can hold any float, else in `.npy`."""
    suffix = output.suffix if output.suffix.lower() in (".exr", ".pfm", ".npy") else ".npy"
    return output.with_name(f"{output.stem}.{name}{suffix}")


def _aov_names(text: str) -> list[str]:
    """The names in a list separated by commas."""
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in NAMES:
            raise argparse.ArgumentTypeError(f"unknown AOV {name!r}; known: {', '.join(NAMES)}")
    return names


def _gradient_tracer(scene: Scene, names: Sequence[str], depth: int, boundary: Callable | None) -> PathTracer:
    """A path tracer with the given estimator, or with the one that the rules choose. Prints the reason of a choice."""
    if boundary is not None:
        return PathTracer(max_depth=depth, boundary=boundary())
    chosen = choose(scene)
    if moving_along(scene, names).any and depth > 1:
        print(f"jaxdr: boundary estimator: {chosen.reason} (--boundary chooses)", file=sys.stderr)
    return PathTracer(max_depth=depth, boundary=chosen.estimator)


def _gradient(options) -> int:
    outputs = _gradient_outputs(Path(options.output))
    for output in outputs:
        check_image_path(output)
        if output.suffix.lower() == ".hdr":
            raise ValueError(f"{output}: derivatives have negative values, which .hdr can't hold; .pfm and .exr can")
    scene = _load_scene(options)
    moved = motion(scene, options.wrt)
    values, tangents = ({name: pair[i] for name, pair in moved.items()} for i in range(2))
    spp, depth = _settings(options)
    tracer = _gradient_tracer(scene, tuple(moved), depth, options.boundary)

    @jit
    def derivative(key):
        def image(values):
            return render(scene.replace(values), key, spp=spp, integrator=tracer)

        return jax.jvp(image, (values,), (tangents,))[1]

    with working(f"{options.output}: compiling and rendering"):
        result = _finite(derivative(jax.random.key(options.seed)))
    for output in outputs:
        if output.suffix.lower() == ".png":
            save_png(output, signed_picture(result.mean(-1), _color_limit(options, result)))
        else:
            write_image(output, result)
        print(output)
    return 0


def _finite(image) -> np.ndarray:
    """The image on the host. Raises `NotFinite` if a value is not finite."""
    image = np.asarray(image, np.float32)
    bad = np.argwhere(~np.isfinite(image).all(-1))
    if len(bad):
        row, column = bad[0]
        raise NotFinite(
            f"{len(bad)} pixels are not finite, the first in row {row}, column {column}; nothing was written"
        )
    return image


def _gradient_outputs(path: Path) -> list[Path]:
    """The files to write: the path itself if it has a suffix, else a picture and the values beside it."""
    if path.suffix:
        return [path]
    return [path.with_name(path.name + suffix) for suffix in (".png", ".npy", *([".exr"] if has_openexr() else []))]


def _color_limit(options, result: np.ndarray) -> float:
    """The value at the ends of the colour bar: that of the options, or the 99.5th percentile of the image."""
    if options.limit is not None:
        return options.limit
    limit = float(np.percentile(np.abs(result.mean(-1)), 99.5))
    return limit or float(np.abs(result).max()) or 1.0


def _plan(options) -> int:
    scene = _load_scene(options)
    boundary = MEASURED if options.boundary == MEASURED else options.boundary()
    with working(f"{options.scene}: compiling and measuring"):
        found = plan(
            scene,
            options.wrt or None,
            options.budget,
            key=jax.random.key(options.seed),
            max_depth=options.max_depth,
            boundary=boundary,
            spp=options.spp,
            depth_tolerance=options.depth_tolerance,
        )
    print(json.dumps(found.to_dict(), indent=2) if options.json else found)
    return 0


def _optimize(options) -> int:
    path = Path(options.config)
    table = read_toml(path, options.set)
    with _way_to_go_on("optimize", options.config, options=options):
        if is_comparison(table):
            return _compare(table, path, options)
        config, summary = _run(table, path, _how(options))
    if isinstance(config, RecoveryConfig):
        pairs = {"loss": (summary["loss_initial"], summary["loss_final"]), **summary["errors"]}
        changes = ", ".join(f"{name} {before:.3g} -> {after:.3g}" for name, (before, after) in pairs.items())
        print(f"{config.output}: {changes} in {summary['iterations']} iterations, {summary['seconds']:.0f} s")
        return 0
    print(
        f"{config.output}: Chamfer distance {summary['chamfer_initial']:.5f} -> {summary['chamfer_final']:.5f} "
        f"({summary['chamfer_ratio']:.1f} times smaller) in {summary['seconds']:.0f} s"
    )
    return 0


def _run(table: dict, path: Path, how: dict[str, Any]) -> tuple[Any, dict]:
    """(config, summary) of a run of `jaxdr optimize`."""
    if is_recovery(table):
        config = recovery_config(table, path)
        return config, recover(config, **how)
    config = optimize_config(table, path)
    return config, optimize(config, **how)


def _compare(table: dict, path: Path, options) -> int:
    """All runs of a config with `[[compare]]`; a mistake in any of them shows before the first."""
    require_matplotlib()
    found, how = variants(table, path), _how(options)
    for variant in found:
        (recovery_config if is_recovery(variant.table) else optimize_config)(variant.table, path)
        print(f"{variant.folder}: {variant.label}", file=sys.stderr)
    rows = compare(found, lambda table, resume: _run(table, path, how | {"resume": resume}), options.resume)
    for row in rows:
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in row.items() if name != "label")
        print(f"{row['label']}: {numbers}")
    return 0


def _how(options) -> dict[str, Any]:
    """The options of a run that are not in its config."""
    return {"resume": options.resume, "overwrite": options.overwrite, "devices": options.devices}


def _cameras(options) -> int:
    output = Path(options.output)
    found = find_cameras_with_bars(Path(options.photos), output, options.seed, options.overwrite)
    first, *others = report(found)
    print(f"{output}: {first}")
    for line in others:
        print(line)
    return 0


def _reconstruct(options) -> int:
    if options.config:
        source, table = options.config, read_toml(Path(options.config), options.set)
    else:
        source, table = "--set", override_table({}, options.set, "the defaults")
    given = {name: getattr(options, name) or "" for name in ("holdout", "masks", "quality")}
    asset = {name: value for name in ("up", "scale", "height") if (value := getattr(options, name)) is not None}
    config = reconstruct_config(table, source, options.folder, options.output, **given, asset=asset)
    command = ["reconstruct", options.folder, "-o", options.output]
    for name, value in ({"config": options.config} | given | asset).items():
        command += [f"--{name}={value}"] if value else []
    with _way_to_go_on(*command, options=options):
        summary = reconstruct(config, **_how(options))
    overlap = f", overlap of masks {summary['iou']['mean']:.4f}" if "iou" in summary else ""
    inside = f" (inside of the masks {summary['psnr_inside']['mean']:.2f})" if "psnr_inside" in summary else ""
    print(
        f"{Path(config.output) / 'asset.glb'}: views {summary['judged_by']}: PSNR {summary['psnr']['mean']:.2f} dB"
        f"{inside}{overlap} in {summary['seconds']:.0f} s"
    )
    if "problem" in summary:
        print(f"jaxdr: {summary['problem']}", file=sys.stderr)
    return 0


def _chart(options) -> int:
    path = Path(options.config)
    config = chart_config(read_toml(path, options.set), path)
    with _way_to_go_on("chart", options.config, options=options):
        summary = chart(config, resume=options.resume, overwrite=options.overwrite)
    left = f"{summary['over_budget']} over the budget, {summary['refused']} refused"
    print(f"{Path(config.output) / 'index.html'}: {summary['measured']} points, {left}")
    for scene, said in summary["default"].items():
        print(f"{scene}: {said}")
    return 0


@contextlib.contextmanager
def _way_to_go_on(*command: str, options) -> Iterator[None]:
    """If a signal or the disk stops the run in this block, name the command that goes on in the message."""
    words = ["jaxdr", *command, *(word for assignment in options.set for word in ("--set", assignment)), "--resume"]
    try:
        yield
    except Interrupted as interruption:
        raise Interrupted(f"{interruption}; go on with: {shlex.join(words)}") from None
    except Stopped as problem:
        raise Stopped(f"{problem}; once that is fixed, go on with: {shlex.join(words)}") from problem


def _view(options) -> int:
    page = write_page(Path(options.folder), Path(options.output) if options.output else None)
    print(page)
    if options.open and not webbrowser.open(page.resolve().as_uri()):
        print("jaxdr: no browser could be started; open the page yourself", file=sys.stderr)
    return 0


def _load_scene(options) -> Scene:
    """The scene with `--set` applied: names with a dot are scene parameters, others go to the loader.

    The loader takes the sensor and the $variables of a Mitsuba file, or camera, width and height for a glTF file.
    """
    assignments = [split_assignment(text) for text in options.set]
    with _warning_lines():
        scene = _read_scene(Path(options.scene), options.ignore_unsupported, _variables(options))
    parameters = every_parameter(scene)
    values = {}
    for name, value in assignments:
        if "." not in name:
            continue
        if name not in parameters:
            raise ValueError(f"--set {name}: unknown parameter; {options.scene} has: {', '.join(parameters)}")
        shape = parameters[name].shape
        try:
            values[name] = jnp.broadcast_to(jnp.asarray(value, float), shape)
        except (TypeError, ValueError):
            raise ValueError(
                f"--set {name}: expected numbers of shape {list(shape)} or one number, got {value!r}"
            ) from None
    return scene.replace(values)


def _variables(options) -> dict:
    """The assignments of `--set` that go to the loader."""
    return {name: value for name, value in map(split_assignment, options.set) if "." not in name}


@contextlib.contextmanager
def _warning_lines() -> Iterator[None]:
    """Print warnings for users as lines on stderr."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        try:
            yield
        finally:
            for warning in caught:
                print(f"jaxdr: warning: {' '.join(str(warning.message).split())}", file=sys.stderr)


def _read_scene(path: Path, ignore_unsupported: bool, variables: dict) -> Scene:
    if not is_gltf(path):
        return load_mitsuba(path, ignore_unsupported=ignore_unsupported, **variables)
    for name, value in variables.items():
        if name != "camera" and (name not in ("width", "height") or not isinstance(value, int) or value < 1):
            raise ValueError(
                f"--set {name}={value}: a glTF file takes width and height, whole pixels, and the name of a camera"
            )
    return load_gltf(path, ignore_unsupported=ignore_unsupported, **variables)


class _UsageError(Exception):
    """The command line can't be parsed."""


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise _UsageError(f"{message} (see {self.prog} --help)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="jaxdr", description="Differentiable rendering in JAX.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"jaxdr {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def add(name, function, summary, compiles=True):
        command = commands.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        command.set_defaults(command=function, compiles=compiles, divides=False)
        if compiles:
            command.add_argument(
                "--set", action="append", default=[], metavar="NAME=VALUE", help="change a value; repeatable"
            )
            what = "neither keep compiled programs in the user's cache folder nor use them"
            command.add_argument("--no-cache", action="store_true", help=what)
        command.add_argument("--debug", action="store_true", help="show the traceback of an error")
        return command

    for name, function, summary in (
        ("render", _render, f"Render a scene file to {', '.join(SUFFIXES)}."),
        ("gradient", _gradient, "Derivative image of a scene for one motion or parameter."),
        ("plan", _plan, "Measure which estimator and settings suit the derivatives of a scene, and explain why."),
    ):
        command = add(name, function, summary)
        command.add_argument("scene", metavar="SCENE", help="Mitsuba 3 XML, .glb or .gltf file")
        command.add_argument(
            "--ignore-unsupported", action="store_true", help="only warn about parts of a file that jaxdr lacks"
        )
        spp = "as many as the budget allows" if name == "plan" else f"the file's sample_count, or {SAMPLES}"
        command.add_argument("--spp", type=_positive(int), help=f"samples per pixel (default: {spp})")
        depth = "measured" if name == "plan" else f"the file's max_depth up to {DEEPEST}, or {MAX_DEPTH}"
        command.add_argument("--max-depth", type=_positive(int), help=f"longest path in segments (default: {depth})")
        command.add_argument("--seed", type=int, default=0, help="seed of the random numbers (default 0)")
        if name == "render":
            what = "path tracer (default), or bidirectional path tracer for caustics and light from behind corners"
            command.add_argument("--integrator", choices=INTEGRATORS, default="path", help=what)
            what = f"also write these, in files beside the image; separated by commas: {', '.join(NAMES)}"
            command.add_argument("--aov", type=_aov_names, default=[], metavar="NAME,...", help=what)
        if name == "gradient":
            what = "spot.translate.x, spot.rotate.z, camera.translate.x, spot.bsdf.reflectance, …"
            command.add_argument("--wrt", required=True, metavar="NAME", help=what)
            what = f"boundary estimator (default: chosen for the scene): {', '.join(ESTIMATORS)}, {OUTSIDE}"
            command.add_argument("--boundary", type=_estimator, metavar="NAME", help=what)
            command.add_argument("--limit", type=_positive(float), help="value at the ends of the colour bar")
        if name == "plan":
            _add_plan_options(command)
            continue
        files = "image file" if name == "render" else "file, or name without suffix for picture and values"
        command.add_argument("-o", "--output", required=True, metavar="FILE", help=files)

    for name, function, summary, kept in (
        (
            "optimize",
            _optimize,
            "Recover a shape or other parameters of a scene from images, as a TOML file describes.",
            "go on from the checkpoint in the output folder",
        ),
        (
            "chart",
            _chart,
            "Chart the error of derivatives against time, by estimator, as a TOML file describes.",
            "measure only what is missing in the output folder",
        ),
    ):
        command = add(name, function, summary)
        command.add_argument("config", metavar="CONFIG.toml")
        command.add_argument("--resume", action="store_true", help=kept)
        command.add_argument("--overwrite", action="store_true", help="delete earlier results in the output folder")
        if name == "optimize":
            _add_device_options(command)
    command = add("cameras", _cameras, "Find the cameras of photographs, for `jaxdr reconstruct`.", compiles=False)
    command.add_argument("photos", metavar="PHOTOS", help="folder of photographs of one object, from all sides")
    command.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the cameras")
    command.add_argument("--seed", type=int, default=0, help="seed of the random numbers (default 0)")
    command.add_argument("--overwrite", action="store_true", help="replace earlier cameras in the output folder")

    command = add("reconstruct", _reconstruct, "Find mesh, textures and light from photographs.")
    command.add_argument(
        "folder", metavar="FOLDER", help="photographs, with their cameras (see docs/reconstruct.md) or without"
    )
    command.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for asset.glb and the rest")
    command.add_argument("--config", metavar="CONFIG.toml", help="settings that differ from the defaults")
    what = "pictures that are held out and not used, such as '*_7' (default: the test pictures, or every eighth)"
    command.add_argument("--holdout", metavar="PATTERN", help=what)
    what = "a folder of masks; auto: those beside the photographs, or they are found (default); none: they are not"
    command.add_argument("--masks", metavar="auto|none|FOLDER", help=what)
    command.add_argument("--up", metavar="AXIS", help="what is up: z, -y or 0,0.2,1 (default: as cameras are held)")
    command.add_argument("--scale", type=float, metavar="METRES", help="of a unit of the cameras' world")
    command.add_argument("--height", type=float, metavar="METRES", help="of the asset, in place of --scale")
    what = "pixels, vertices, texels and steps (default: normal)"
    command.add_argument("--quality", choices=list(QUALITIES), help=what)
    command.add_argument("--resume", action="store_true", help="go on from the checkpoint in the output folder")
    command.add_argument("--overwrite", action="store_true", help="delete earlier results in the output folder")
    _add_device_options(command)

    command = add("view", _view, "Write a web page of a folder of results, and print its path.", compiles=False)
    command.add_argument("folder", metavar="RUN", help="output folder of optimize, reconstruct or chart")
    command.add_argument("-o", "--output", metavar="PAGE.html", help=f"the page (default: RUN/{PAGE_NAME})")
    command.add_argument("--open", action="store_true", help="open it in the browser")
    return parser


def _add_device_options(command) -> None:
    """Add options for the devices and processes that share a run."""
    command.set_defaults(divides=True)
    what = "devices that share the work: N GPUs, or the processor as N devices (default: all GPUs, or one processor)"
    command.add_argument("--devices", type=_positive(int), metavar="N", help=what)
    what = "join the run's other processes, as SLURM, Open MPI or Kubernetes names them"
    command.add_argument("--distributed", action="store_true", help=what)
    command.add_argument("--coordinator", metavar="HOST:PORT", help="process 0 of a run of several processes")
    command.add_argument("--processes", type=_positive(int), metavar="N", help="how many processes the run has")
    command.add_argument("--process", type=int, metavar="I", help="number of this process, from 0")


def _add_plan_options(command) -> None:
    what = "parameter or motion that is differentiated, repeatable (default: all vertices)"
    command.add_argument("--wrt", action="append", default=[], metavar="NAME", help=what)
    what = "time for a derivative image in seconds (default 1)"
    command.add_argument("--budget", type=_positive(float), default=1.0, metavar="SECONDS", help=what)
    what = f"boundary estimator (default: measured): {MEASURED}, {', '.join(ESTIMATORS)}, {OUTSIDE}"
    command.add_argument("--boundary", type=_estimator_or_auto, default=MEASURED, metavar="NAME", help=what)
    what = f"share of light and derivative that longer paths may carry (default {DEPTH_TOLERANCE})"
    command.add_argument("--depth-tolerance", type=_positive(float), default=DEPTH_TOLERANCE, help=what)
    command.add_argument("--json", action="store_true", help="print the plan as JSON, with all figures")


def _estimator(name: str, others: tuple[str, ...] = ()) -> Callable[..., Any]:
    """The class or function of a boundary estimator, for argparse."""
    try:
        return estimator_class(name, others)
    except ValueError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from None


def _estimator_or_auto(name: str) -> Any:
    return MEASURED if name == MEASURED else _estimator(name, (MEASURED,))


def _positive(kind):
    def parse(text):
        value = kind(text)
        if not value > 0:
            raise argparse.ArgumentTypeError(f"must be positive, got {text}")
        return value

    parse.__name__ = {int: "whole number", float: "number"}[kind]
    return parse


def _complain(problem: Exception, code: int) -> int:
    """Print an error in one line; items of a list of problems, as scene files may have, get a line each."""
    first, *items = str(problem).split("\n  ")
    for start, text in [("jaxdr: error: ", first), *(("  ", item) for item in items)]:
        print(start + " ".join(text.split()), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
