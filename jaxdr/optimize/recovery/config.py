"""What `jaxdr optimize` is told to recover parameters of a scene: frozen dataclasses, one a TOML table."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from jaxdr.optimize.config import Cameras, Integrator, Reporting, Samples, Vector, with_integrator
from jaxdr.optimize.config_checks import at_least, check_run, found_file, not_negative, positive, require
from jaxdr.optimize.recovery.parameters import Motion
from jaxdr.optimize.recovery.scenes import check_scene
from jaxdr.optimize.strict_toml import build

FILE_OPTIONS = ("mesh", "albedo")  # options of procedural scenes that name files


@dataclass(frozen=True)
class SceneSource:
    """A procedural scene (`jaxdr.optimize.recovery.scenes`) by `name`, with `options`; or a scene `file`.

    Of a Mitsuba file `options` set the `$variables`, of a glTF file width and height.
    """

    name: str = ""
    file: str = ""
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        require(bool(self.name) != bool(self.file), "name", "give either a name or a file", self.name)
        if self.name:
            check_scene(self.name, self.options)


@dataclass(frozen=True)
class TargetSource:
    """What the images to be matched show: `images`, files in the order of the views, or a scene to render.

    Without a `name` or `file` that is the scene itself before its parameters get their initial values, with `options`
    in the place of its own.
    """

    name: str = ""
    file: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    images: tuple[str, ...] = ()

    def __post_init__(self):
        given = [key for key in ("name", "file", "images") if getattr(self, key)]
        require(len(given) <= 1, "name", "give at most one of name, file and images", given)
        if self.images and self.options:
            raise ValueError("options: images have none")
        if self.name:
            check_scene(self.name, self.options)


@dataclass(frozen=True)
class Parameter:
    """A parameter of the scene by its `name`, what it starts from, and how it depends on the numbers optimised.

    - `initial`: its value at the start, one number for all components or a list; left out, what the scene has. With a
      `motion` the motion from there: degrees and scene units.
    - `bounds`: the value stays strictly between them, as a logistic function of what is optimised.
    - `motion`: a matrix (then "rigid" by default) or vertices move as a whole: "rigid" is rotation and translation,
      "rotation" and "translation" one of them, "angle" one number about `axis`, in world space.
    - `smoothing`: strength of `LargeSteps` for vertices without a motion; 19 by default.
    - `learning_rate`, `final_learning_rate`: of Adam, in its own units: scene units for vertices and translations,
      radians for rotations, for a bounded value about a quarter of the interval. It falls exponentially over all
      iterations. Levenberg-Marquardt needs none.
    """

    name: str
    initial: float | tuple[float, ...] | None = None
    bounds: tuple[float, float] | None = None
    motion: Literal["", "rigid", "rotation", "translation", "angle"] = ""
    axis: Vector = (0.0, 0.0, 1.0)
    smoothing: float | None = None
    learning_rate: float | None = None
    final_learning_rate: float | None = None

    def __post_init__(self):
        positive(self, "learning_rate", "final_learning_rate")
        not_negative(self, "smoothing")
        require(any(self.axis), "axis", "must not be zero", self.axis)
        moving = self.moving
        if moving and (self.bounds is not None or self.smoothing is not None):
            raise ValueError("motion: can't go together with bounds or smoothing; leave it or those out")
        if self.smoothing is not None and not self.is_vertices:
            raise ValueError(f"smoothing: is for vertices, not for {self.name}")
        if self.is_vertices and not moving and (self.bounds is not None or self.initial is not None):
            raise ValueError("motion: needed for bounds or initial of vertices; give it, or leave those out")
        if moving and not (self.is_vertices or self.is_matrix):
            raise ValueError(f"motion: is for vertices and to_world, not for {self.name}")
        if moving and self.initial is not None:
            values = self.initial if isinstance(self.initial, tuple) else (self.initial,)
            count = Motion.COUNTS[moving]
            require(len(values) == count, "initial", f"{moving} takes {count} numbers (degrees, then units)", values)

    @property
    def is_vertices(self) -> bool:
        """Whether the parameter is a shape's vertices."""
        return self.name.endswith(".vertices")

    @property
    def is_matrix(self) -> bool:
        """Whether the parameter is a matrix."""
        return self.name.endswith(".to_world")

    @property
    def moving(self) -> str:
        """The kind of motion, "" for none."""
        return self.motion or ("rigid" if self.is_matrix else "")


@dataclass(frozen=True)
class Adam:
    """Stochastic steps: new random numbers and `views_per_step` views each, every view once before any comes again."""

    kind: Literal["adam"] = "adam"
    iterations: int = 300
    views_per_step: int = 1
    loss: Literal["l1", "l2", "two_key_l2"] = "l1"

    def __post_init__(self):
        at_least(1, self, "iterations", "views_per_step")


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Least squares over all pixels of all views, with the same random numbers in every iteration.

    An iteration renders the images, and one derivative image for every number that is optimised. The run ends after
    `iterations`. It ends earlier when an accepted step changes the images by less than `tolerance`, relative to the
    norm of the targets, and when three steps in a row were rejected.

    - `damping`: at the start, relative to the squared norms of the columns of the Jacobian there.
    - `blur`: standard deviations, in pixels, of Gaussian filters. Images are compared with one after another. Coarse
      ones match from further away. Each has an equal share of the iterations, and what others leave over.
    """

    kind: Literal["levenberg_marquardt"] = "levenberg_marquardt"
    iterations: int = 29
    tolerance: float = 1e-4
    damping: float = 0.01
    blur: tuple[float, ...] = (0.0,)

    def __post_init__(self):
        positive(self, "tolerance", "damping")
        require(bool(self.blur) and min(self.blur) >= 0, "blur", "must be a list of numbers from zero on", self.blur)
        least = 2 * len(self.blur)
        require(self.iterations >= least, "iterations", f"must be at least {least}, two for each blur", self.iterations)


@dataclass(frozen=True)
class Report(Reporting):
    """How often, in iterations: what `Reporting` has, and the `errors` of the parameters, if the target is known."""

    errors: int = 10


@dataclass(frozen=True)
class RecoveryConfig:
    """Everything about one run. The same config and seed give the same result, bit for bit on CPU.

    `cameras` take the place of the scene's camera; left out, that is the only view.
    """

    output: str
    scene: SceneSource
    parameters: tuple[Parameter, ...]
    seed: int = 0
    target: TargetSource = TargetSource()
    cameras: Cameras | None = None
    integrator: Integrator = field(default_factory=Integrator)
    samples: Samples = field(default_factory=Samples)
    optimizer: Adam | LevenbergMarquardt = Adam()
    report: Report = Report()

    def __post_init__(self):
        check_run(self)
        require(bool(self.parameters), "parameters", "name at least one", [])
        names = [parameter.name for parameter in self.parameters]
        for i, (name, parameter) in enumerate(zip(names, self.parameters, strict=True)):
            require(name not in names[:i], f"parameters[{i}].name", "must not be named twice", name)
            if isinstance(self.optimizer, Adam):
                require(
                    parameter.learning_rate is not None, f"parameters[{i}].learning_rate", "Adam needs a number", None
                )
                continue
            for key in ("learning_rate", "final_learning_rate"):
                value = getattr(parameter, key)
                require(value is None, f"parameters[{i}].{key}", "Levenberg-Marquardt takes none", value)
        views = 1 if self.cameras is None else self.cameras.views
        if isinstance(self.optimizer, Adam):
            key, per_step = "optimizer.views_per_step", self.optimizer.views_per_step
            require(per_step <= views, key, f"must not exceed the number of views, {views}", per_step)
        if self.target.images:
            require(
                len(self.target.images) == views,
                "target.images",
                f"need {views}, one for each view",
                self.target.images,
            )
        if self.cameras is not None and "camera.to_world" in names:
            raise ValueError("cameras: give the views, so camera.to_world can't be a parameter; leave one of them out")
        if not self.target.images and not self.target.name and not self.target.file and self.scene.name:
            check_scene(self.scene.name, self.target.options)


def recovery_config(table: dict, path: Path) -> RecoveryConfig:
    """The config in a TOML table. Files may be named relative to the config `path` or to the current folder.

    Raises ValueError that names the file, the key and what was expected.
    """
    config = build(RecoveryConfig, with_integrator(table), str(path))
    scene, target = config.scene, config.target
    images = tuple(found_file(path, f"target.images[{i}]", file) for i, file in enumerate(target.images))
    scene = _with_files(path, "scene", scene)
    target = dataclasses.replace(_with_files(path, "target", target), images=images)
    return dataclasses.replace(config, scene=scene, target=target)


def is_recovery(table: dict) -> bool:
    """Whether a TOML table is about recovering parameters of a scene."""
    return bool({"scene", "parameters"} & table.keys())


def _with_files(path: Path, key: str, source):
    options = {
        name: found_file(path, f"{key}.options.{name}", value) if name in FILE_OPTIONS and value else value
        for name, value in source.options.items()
    }
    file = found_file(path, f"{key}.file", source.file) if source.file else ""
    return dataclasses.replace(source, file=file, options=options)
