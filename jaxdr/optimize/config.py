"""What `jaxdr optimize` is told: frozen dataclasses, one a TOML table. Lengths are in scene units, z is up."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from jaxdr.boundary.named import estimator_class
from jaxdr.geometry import shapes
from jaxdr.geometry.mesh import Mesh
from jaxdr.integrators import INTEGRATORS, BidirectionalPathTracer, PathTracer
from jaxdr.optimize.config_checks import (
    at_least,
    check_choice,
    check_options,
    check_run,
    found_file,
    not_negative,
    positive,
    require,
)
from jaxdr.optimize.field_aligned import LEAST
from jaxdr.optimize.strict_toml import build, read_toml
from jaxdr.optimize.surroundings import FixedShape, material_of
from jaxdr.untrusted import check_memory, check_pixels

Color = float | tuple[float, float, float]
Vector = tuple[float, float, float]

TARGET_SHAPES: dict[str, Callable[..., Mesh]] = {
    "sphere": shapes.sphere,
    "displaced_sphere": shapes.displaced_sphere,
    "box": shapes.box,
    "torus": shapes.torus,
    "trefoil_tube": shapes.trefoil_tube,
    "pawn": shapes.pawn,
    "duck": shapes.duck,
}


def _as_tuple(color: Color) -> tuple[float, ...]:
    return color if isinstance(color, tuple) else (color,)


@dataclass(frozen=True)
class Target:
    """The shape to be found: a procedural `shape` with `parameters`, or the mesh at `path`.

    It is moved so that its bounding box is centred at the origin, its longest side `size` long; the axis `up` of
    the file becomes z. `material` is that of `jaxdr.optimize.surroundings.FixedShape`; without it the object is
    diffuse, with a `reflectance`.
    """

    shape: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)
    path: str = ""
    size: float = 1.0
    up: Literal["x", "y", "z"] = "z"
    shading: Literal["flat", "smooth"] = "flat"
    reflectance: Color = 0.5
    material: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        material_of(self.material)
        require(bool(self.shape) != bool(self.path), "shape", "give either a shape or a path", self.shape)
        positive(self, "size")
        if self.shape:
            check_choice("shape", self.shape, TARGET_SHAPES)
            check_options("parameters", TARGET_SHAPES[self.shape], self.parameters, self.shape, "parameter")
        elif self.parameters:
            raise ValueError("parameters: only a procedural shape has parameters, a mesh file has none")


@dataclass(frozen=True)
class Initial:
    """Where the optimisation starts: a sphere at the origin, an icosahedron subdivided `subdivisions` times.

    With `vertices`, in place of those: a geodesic one of the number 10 n² + 2 that comes closest.
    """

    subdivisions: int = 3
    vertices: int = 0
    radius: float = 0.4
    shading: Literal["flat", "smooth"] = "flat"

    def __post_init__(self):
        require(0 <= self.subdivisions <= 8, "subdivisions", "must be between 0 and 8", self.subdivisions)
        require(self.vertices == 0 or self.vertices >= 12, "vertices", "must be at least 12", self.vertices)
        positive(self, "radius")


@dataclass(frozen=True)
class Cameras:
    """Views on a spiral with equal solid angles around the z axis (Fibonacci), between two `elevation`s in degrees.

    All look at the origin from `distance`. `fov` is horizontal, in degrees; `resolution` is width and height in pixels.
    """

    views: int = 8
    distance: float = 3.0
    fov: float = 32.0
    resolution: int = 96
    elevation: tuple[float, float] = (5.0, 75.0)

    def __post_init__(self):
        low, high = self.elevation
        at_least(1, self, "views")
        positive(self, "distance")
        require(0 < self.fov < 180, "fov", "must be between 0 and 180 degrees", self.fov)
        require(self.resolution >= 1, "resolution", "must be at least 1 pixel", self.resolution)
        check_pixels(self.resolution, self.resolution, "resolution")
        check_memory(12 * self.views * self.resolution**2, "views")  # the target views, RGB in float32
        require(-90 < low <= high < 90, "elevation", "must be two increasing angles between -90 and 90", (low, high))


@dataclass(frozen=True)
class Turntable:
    """In place of cameras that go round: one camera at `position`, which looks at `target`, and the object turns.

    In view number i the object is turned so that camera i of `Cameras` would see of it what is seen from -y, with z up.
    """

    position: Vector
    target: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self):
        require(self.position != self.target, "position", "must differ from target", self.position)


@dataclass(frozen=True)
class Light:
    """Rectangular area emitter that faces the point `target`; RGB or grey `radiance`."""

    position: Vector = (1.0, -1.0, 3.0)
    target: Vector = (0.0, 0.0, 0.0)
    width: float = 1.0
    height: float = 1.0
    radiance: Color = 10.0

    def __post_init__(self):
        positive(self, "width", "height")
        require(self.position != self.target, "position", "must differ from target", self.position)


@dataclass(frozen=True)
class Floor:
    """Horizontal square of edge length `size` at z = `height`, on which shadows fall."""

    height: float = -0.7
    size: float = 6.0
    reflectance: Color = 0.5

    def __post_init__(self):
        positive(self, "size")


AUTO, PLAN = "auto", "plan"  # chosen for the scene by rules; measured before the run begins


@dataclass(frozen=True)
class Integrator:
    """The path tracer: see `jaxdr.PathTracer`; with `kind` "bdpt" the bidirectional one. `boundary` names an estimator,
    also "FILE.py:CLASS" or "MODULE:CLASS", or is "auto" (chosen for the scene) or "none" (interior term only);
    `boundary_options` are the estimator's arguments. With "plan" for `max_depth`, `boundary` or both `jaxdr.plan`
    measures before the run begins; so it does for both where a file says nothing about the integrator."""

    max_depth: int | Literal["plan"] = 2
    primary: Literal["fixed_ray", "material", "warp"] = "fixed_ray"
    sampling: Literal["mis", "emitter"] = "mis"
    boundary: str = AUTO
    boundary_options: dict[str, Any] = field(default_factory=dict)
    kind: Literal["path", "bdpt"] = "path"

    def __post_init__(self):
        only = "" if self.kind == "path" else f'with kind "{self.kind}"'
        only = 'with max_depth or boundary "plan"' if self.planned else only
        for key, default in (("primary", "fixed_ray"), ("sampling", "mis")) if only else ():
            rule = f"must be {default!r} {only}"
            require(getattr(self, key) == default, key, rule, getattr(self, key))
        if not self.planned:
            self.build()
            return
        require(self.kind == "path", "kind", 'must be "path" with max_depth or boundary "plan"', self.kind)
        if self.boundary == PLAN:
            self._check_options()
        else:
            self.estimator()
        if self.max_depth != PLAN:
            self._check_depth()

    @property
    def planned(self) -> bool:
        """Whether anything is left to `jaxdr.plan`."""
        return PLAN in (self.max_depth, self.boundary)

    def estimator(self) -> Any:
        """The boundary estimator or "auto"; ValueErrors start with the key that is wrong."""
        if self.boundary == AUTO:
            self._check_options()
            return AUTO
        try:
            made = estimator_class(self.boundary, (AUTO, PLAN))
        except ValueError as problem:
            raise ValueError(f"boundary: {problem}") from None
        check_options("boundary_options", made, self.boundary_options, self.boundary, "parameter")
        try:
            return made(**self.boundary_options)
        except ValueError as problem:
            raise ValueError(f"boundary_options: {problem}") from None

    def build(self) -> PathTracer | BidirectionalPathTracer:
        """The integrator, unless it is `planned`; ValueErrors start with the key that is wrong."""
        boundary = self.estimator()
        self._check_depth()
        depth = int(self.max_depth)
        if self.kind == "path":
            return PathTracer(depth, boundary, self.primary, self.sampling)
        try:
            return INTEGRATORS[self.kind](depth, boundary=boundary)
        except ValueError as problem:
            raise ValueError(f"boundary: {problem}") from None

    def _check_options(self) -> None:
        if self.boundary in (AUTO, PLAN):
            rule = f'boundary "{self.boundary}" has none'
            require(not self.boundary_options, "boundary_options", rule, self.boundary_options)

    def _check_depth(self) -> None:
        require(int(self.max_depth) >= 1, "max_depth", "must be at least 1", self.max_depth)


@dataclass(frozen=True)
class Samples:
    """Samples per pixel: of the `target` views, the `image` in the loss, its `gradient`, and `pictures` in grids."""

    target: int = 256
    image: int = 16
    gradient: int = 8
    pictures: int = 64

    def __post_init__(self):
        at_least(1, self)


def require_one_size(of: "Remesh | Level") -> None:
    """Raise ValueError for a number of vertices that no mesh has, and where it comes with a length of edges."""
    require(of.vertices == 0 or of.vertices >= 4, "vertices", "must be at least 4", of.vertices)
    require(not (of.edge_length and of.vertices), "vertices", "give this or edge_length, not both", of.vertices)


@dataclass(frozen=True)
class Remesh:
    """Before step `iteration`, remesh to edges about `edge_length` long, or to so many `vertices`; the optimiser starts
    afresh. With `every`, again whenever that many further steps are done, before step `until` (0: to the end).
    `field_aligned`: with edges in long chains (`jaxdr.remesh_field_aligned`), to so many `vertices` alone."""

    iteration: int
    edge_length: float = 0.0
    vertices: int = 0
    field_aligned: bool = False
    every: int = 0
    until: int = 0

    def __post_init__(self):
        at_least(1, self, "iteration")
        not_negative(self, "every")
        rule = "needs every, and must be larger than iteration"
        require(self.until == 0 or (self.every > 0 and self.until > self.iteration), "until", rule, self.until)
        require(self.edge_length >= 0, "edge_length", "must be positive", self.edge_length)
        require_one_size(self)
        require(self.edge_length > 0 or self.vertices > 0, "edge_length", "give it, or vertices", self.edge_length)
        if self.field_aligned:
            rule = f"must be at least {LEAST} with field_aligned"
            require(self.vertices >= LEAST, "vertices", rule, self.vertices)

    def steps(self, iterations: int) -> range:
        """The steps before which the mesh is remeshed, in a run of so many steps."""
        end = (self.until or iterations) if self.every else self.iteration + 1
        return range(self.iteration, end, self.every or 1)


@dataclass(frozen=True)
class Level:
    """A stage of a run from coarse to fine: `resolution` of the views (0: that of the cameras), samples per pixel of
    `image` and `gradient`, `views_per_step`, and strength `lam` of the preconditioner (0: those of the config). Unless
    0, the mesh gets edges about `edge_length` long or just so many `vertices` when the level begins. With another mesh
    or another `lam` the optimiser starts afresh."""

    resolution: int = 0
    image: int = 0
    gradient: int = 0
    views_per_step: int = 0
    lam: float = 0.0
    edge_length: float = 0.0
    vertices: int = 0

    def __post_init__(self):
        not_negative(self)
        require_one_size(self)

    @property
    def remeshes(self) -> bool:
        """Whether the mesh gets a new topology when the level begins."""
        return self.edge_length > 0 or self.vertices > 0


@dataclass(frozen=True)
class Optimizer:
    """Steps of `adam_uniform` on the latent coordinates of `LargeSteps` with strength `lam`.

    The learning rate goes from `learning_rate` to `final_learning_rate` exponentially over all iterations. `loss` is
    the mean over the `views_per_step` views of a step; every view comes once before any comes again. A run with
    levels goes on to the next where a step's `signal_to_noise` ratio (see `jaxdr.optimize.signal`) falls below this.
    """

    iterations: int = 300
    learning_rate: float = 0.01
    final_learning_rate: float = 0.002
    lam: float = 19.0
    views_per_step: int = 4
    loss: Literal["l1", "l2", "two_key_l2"] = "l1"
    signal_to_noise: float = 1.0
    remesh: tuple[Remesh, ...] = ()

    def __post_init__(self):
        at_least(1, self, "iterations", "views_per_step")
        positive(self, "learning_rate", "final_learning_rate", "signal_to_noise")
        not_negative(self, "lam")
        at = [i for remesh in self.remesh for i in remesh.steps(self.iterations)]
        require(at == sorted(set(at)), "remesh", "iterations must increase", at)


@dataclass(frozen=True)
class Reporting:
    """How often, in iterations: `pictures` with GLB snapshots, a `checkpoint`.

    Picture grids show `views` of the cameras; Chamfer distances use `chamfer_samples` points on each surface.
    """

    pictures: int = 50
    checkpoint: int = 50
    views: int = 4
    chamfer_samples: int = 20_000

    def __post_init__(self):
        at_least(1, self)


@dataclass(frozen=True)
class Report(Reporting):
    """How often, in iterations: what `Reporting` has, and the `chamfer` distance."""

    chamfer: int = 25


@dataclass(frozen=True)
class OptimizeConfig:
    """Everything about one run. The same config and seed give the same result, bit for bit on CPU.

    With `levels` it goes from coarse to fine; the last one has the resolution of the cameras.
    """

    target: Target
    output: str
    seed: int = 0
    initial: Initial = Initial()
    cameras: Cameras = Cameras()
    lights: tuple[Light, ...] = (Light(),)
    environment: Color = 0.0
    floor: Floor | None = None
    shapes: tuple[FixedShape, ...] = ()
    turntable: Turntable | None = None
    integrator: Integrator = Integrator()
    samples: Samples = Samples()
    optimizer: Optimizer = Optimizer()
    levels: tuple[Level, ...] = ()
    report: Report = Report()

    def __post_init__(self):
        check_run(self)
        views, per_step = self.cameras.views, self.optimizer.views_per_step
        require(per_step <= views, "optimizer.views_per_step", f"must not exceed cameras.views = {views}", per_step)
        if self.levels:
            self._check_levels()
        dark = not self.lights and not any(_as_tuple(self.environment))
        require(not dark, "lights", "the scene is dark: give a light or an environment", [])

    def _check_levels(self) -> None:
        full, views = self.cameras.resolution, self.cameras.views
        remesh, sized = self.optimizer.remesh, any(level.remeshes for level in self.levels)
        rule = "levels that remesh are there already: leave it out, or their edge_length and vertices"
        require(not (remesh and sized), "optimizer.remesh", rule, remesh)
        sizes = [level.resolution or full for level in self.levels]
        rule = f"resolutions must not fall, and end with cameras.resolution = {full}"
        require(sizes == sorted(sizes) and sizes[-1] == full, "levels", rule, sizes)
        for name in ("edge_length", "vertices"):
            first = getattr(self.levels[0], name)
            require(first == 0, f"levels[0].{name}", "the first level has the initial mesh: leave it out", first)
        for i, level in enumerate(self.levels):
            key, count = f"levels[{i}].views_per_step", level.views_per_step
            require(count <= views, key, f"must not exceed cameras.views = {views}", count)

    def stages(self) -> tuple[Level, ...]:
        """The levels with all numbers filled in; a run without levels has one."""
        samples, count = self.samples, self.optimizer.views_per_step
        return tuple(
            Level(
                level.resolution or self.cameras.resolution,
                level.image or samples.image,
                level.gradient or samples.gradient,
                level.views_per_step or count,
                level.lam or self.optimizer.lam,
                level.edge_length,
                level.vertices,
            )
            for level in self.levels or (Level(),)
        )


def read_config(path: Path, overrides: Sequence[str] = ()) -> OptimizeConfig:
    """The config in a TOML file, with `a.b=c` overrides. `target.path` may be relative to the file or to the current
    folder; `output` is relative to the current folder.

    Raises ValueError that names the file, the key and what was expected.
    """
    return optimize_config(read_toml(path, overrides), path)


def optimize_config(table: dict, path: Path) -> OptimizeConfig:
    """The config in a TOML table, which was read from `path`."""
    config = build(OptimizeConfig, with_integrator(table), str(path))

    def found(part, key: str):
        return dataclasses.replace(part, path=found_file(path, f"{key}.path", part.path, "a mesh file"))

    shapes = [found(s, f"shapes[{i}]") if s.path else s for i, s in enumerate(config.shapes)]
    target = found(config.target, "target") if config.target.path else config.target
    return dataclasses.replace(config, target=target, shapes=tuple(shapes))


def with_integrator(table: dict) -> dict:
    """The table of a config file, whose integrator is left to `jaxdr.plan` if it has none."""
    return {"integrator": {"max_depth": PLAN, "boundary": PLAN}} | table
