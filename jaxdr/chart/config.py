"""The config of `jaxdr chart`: frozen dataclasses, one for each TOML table."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from jaxdr.boundary.named import estimator_class
from jaxdr.chart.scenes import check_scene_options
from jaxdr.integrators import INTEGRATORS, Integrator
from jaxdr.optimize.config import AUTO, Vector
from jaxdr.optimize.config_checks import check_options, found_file, require
from jaxdr.optimize.strict_toml import build


@dataclass(frozen=True)
class Motion:
    """The motion of the vertices of `shape`, by one number t that is 0 at rest. The derivative is by t.

    - "translate": along `direction`, in scene units.
    - "rotate": right-handed, in radians, about `axis` through `pivot` (by default the middle of the bounding box).
    - "vertices": along the field in the file `velocities` ([V, 3], .npy), or one `vertex`, by its number, along
      `direction`.
    """

    shape: str
    kind: Literal["translate", "rotate", "vertices"] = "translate"
    direction: Vector = (1.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    pivot: Vector | None = None
    vertex: int | None = None
    velocities: str = ""

    def __post_init__(self):
        require(any(self.direction), "direction", "must not be zero", self.direction)
        require(any(self.axis), "axis", "must not be zero", self.axis)
        named = (self.vertex is not None) + bool(self.velocities)
        wanted = 1 if self.kind == "vertices" else 0
        require(
            named == wanted,
            "vertex",
            "kind vertices takes either vertex or velocities, other kinds take neither",
            self.vertex,
        )


@dataclass(frozen=True)
class Stored:
    """A derivative image [H, W, 3] in a `file` (.npy), and the root mean square `noise` of its values.

    `step`: half the width of the central difference that made the image. Estimators are then averaged over that width.
    0 for a derivative at t = 0.
    """

    file: str
    noise: float
    kind: Literal["stored"] = "stored"
    step: float = 0.0

    def __post_init__(self):
        require(self.noise >= 0, "noise", "must not be negative", self.noise)
        require(self.step >= 0, "step", "must not be negative", self.step)


@dataclass(frozen=True)
class FiniteDifferences:
    """(I(step) - I(-step)) / (2 step) with common random numbers, as mean of `batches` of `samples` per pixel each."""

    step: float
    kind: Literal["finite_differences"] = "finite_differences"
    samples: int = 256
    batches: int = 16

    def __post_init__(self):
        require(self.step > 0, "step", "must be positive", self.step)
        require(self.samples >= 1, "samples", "must be at least 1", self.samples)
        require(self.batches >= 4, "batches", "must be at least 4: their spread is the noise", self.batches)


@dataclass(frozen=True)
class ChartScene:
    """A scene `file` (Mitsuba XML or glTF), or a `procedural` one by its name, with `options`.

    The file may be a config of `jaxdr optimize` that makes a mesh from a sphere. The scene is then a view of its
    target, shape `object`, or of what it starts from: see `jaxdr.chart.scenes.view_of_config`.

    `directly_visible`: whether the shape that moves is in view. If only its shadow is, Mitsuba's integrators leave out
    their interior and primary terms, which are zero.
    """

    name: str
    motion: Motion
    reference: Stored | FiniteDifferences
    file: str = ""
    procedural: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    max_depth: int = 2
    directly_visible: bool = True

    def __post_init__(self):
        require(
            self.name.replace("_", "").replace("-", "").isalnum(),
            "name",
            "must have letters, digits, _ and - only",
            self.name,
        )
        given = bool(self.procedural) != bool(self.file)
        require(given, "procedural", "give either a procedural scene or a file", self.procedural)
        require(self.max_depth >= 1, "max_depth", "must be at least 1", self.max_depth)
        if self.procedural:
            check_scene_options(self.procedural, self.options)


@dataclass(frozen=True)
class Estimator:
    """A line of the chart: a `boundary` estimator with `options`, in an `integrator` with `integrator_options`.

    `boundary` is the name of an estimator of this library, "auto" (the default, chosen for the scene), "none",
    "FILE.py:CLASS" (from the current folder), or "MODULE:CLASS". `samples`: a ladder of samples per pixel of its own,
    in place of the common one.
    """

    boundary: str
    label: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    integrator: Literal["path", "bdpt"] = "path"
    integrator_options: dict[str, Any] = field(default_factory=dict)
    samples: tuple[int, ...] = ()

    def __post_init__(self):
        if self.by_default:
            require(not self.options, "options", 'boundary "auto" has none', self.options)
        else:
            try:
                made = estimator_class(self.boundary, (AUTO,))
            except ValueError as problem:
                raise ValueError(f"boundary: {problem}") from None
            check_options("options", made, self.options, self.boundary)
        check_options("integrator_options", INTEGRATORS[self.integrator], self.integrator_options, self.integrator)
        for name in ("max_depth", "boundary"):
            if name in self.integrator_options:
                raise ValueError(f"integrator_options.{name}: is set by the scene's max_depth, and by boundary")
        _check_ladder(self.samples)
        self.build(2)

    @property
    def by_default(self) -> bool:
        """Whether rules choose the estimator."""
        return self.boundary == AUTO

    @property
    def name(self) -> str:
        """The label, or a name made from the names and options."""
        options = self.options | self.integrator_options
        settings = "".join(f", {key}={value}" for key, value in options.items())
        kind = self.boundary.rpartition(":")[2]
        return self.label or f"{'bdpt ' if self.integrator == 'bdpt' else ''}{kind}{settings}"

    def build(self, max_depth: int) -> Integrator:
        """The integrator. Raises ValueError, which starts with the wrong key."""
        try:
            boundary = AUTO if self.by_default else estimator_class(self.boundary)(**self.options)
            return INTEGRATORS[self.integrator](max_depth, boundary=boundary, **self.integrator_options)
        except (TypeError, ValueError) as problem:
            raise ValueError(f"options: {problem}") from None


@dataclass(frozen=True)
class Vertices:
    """The gradient by every vertex, in reverse mode, of half the mean squared difference to the image at t = `target`.

    The difference is rendered once, with `image_samples` per pixel, and kept fixed. With `residual` "ones" the gradient
    is that of the sum of all values of the image, and there is no target. The reference is the mean of
    `batches` runs of the estimator with the label `reference`, with `samples` per pixel each.
    """

    reference: str
    target: float = 0.0
    residual: Literal["difference", "ones"] = "difference"
    image_samples: int = 256
    samples: int = 64
    batches: int = 16

    def __post_init__(self):
        if self.residual == "ones":
            require(self.target == 0, "target", 'has no meaning with residual "ones"', self.target)
        else:
            require(self.target != 0, "target", "must not be zero: at the optimum there is no gradient", self.target)
        for key in ("image_samples", "samples"):
            require(getattr(self, key) >= 1, key, "must be at least 1", getattr(self, key))
        require(self.batches >= 4, "batches", "must be at least 4: their spread is the noise", self.batches)


@dataclass(frozen=True)
class ChartConfig:
    """Everything about one chart.

    - `folder`: where scene files and stored references are; relative to the config or the current folder.
    - `samples`: the ladder of samples per pixel.
    - `keys`: calls at each rung of the ladder. They are spread over `positions` within the reference's step, if it has
      one.
    - `budget`: seconds that a call may take. The ladder of an estimator ends at the first rung that takes more.
    - `peers`: whether Mitsuba's projective integrators are further lines; `peer_samples`: their ladder.
    - `until`: seconds up to which lines of the pictures go on, as means of more calls; 0 leaves that out.
    - `terms`: samples per pixel at which the standard deviation of each term is measured; 0 leaves that out.
    - `memory`: whether the peak memory of each estimator is measured, in a fresh process.
    """

    output: str
    scenes: tuple[ChartScene, ...]
    estimators: tuple[Estimator, ...]
    seed: int = 0
    folder: str = ""
    samples: tuple[int, ...] = (1, 4, 16, 64)
    keys: int = 16
    positions: int = 4
    budget: float = 10.0
    until: float = 0.0
    peers: bool = False
    peer_samples: tuple[int, ...] = ()
    terms: int = 16
    memory: bool = True
    vertices: Vertices | None = None

    def __post_init__(self):
        require(0 <= self.seed < 2**31, "seed", "must be between 0 and 2^31 - 1", self.seed)
        require(bool(self.output.strip()), "output", "must name the folder for the results", self.output)
        require(bool(self.scenes), "scenes", "give at least one", [])
        require(bool(self.estimators), "estimators", "give at least one", [])
        require(bool(self.samples), "samples", "give at least one count", [])
        _check_ladder(self.samples)
        _check_ladder(self.peer_samples, "peer_samples")
        require(self.positions >= 1, "positions", "must be at least 1", self.positions)
        good = self.keys >= 2 * self.positions and self.keys % self.positions == 0
        require(good, "keys", f"must be a multiple of positions = {self.positions}, and at least twice it", self.keys)
        require(self.budget > 0, "budget", "must be positive", self.budget)
        require(self.until >= 0, "until", "must not be negative", self.until)
        require(self.terms >= 0, "terms", "must not be negative", self.terms)
        for key, names in (
            ("scenes", [s.name for s in self.scenes]),
            ("estimators", [e.name for e in self.estimators]),
        ):
            twice = sorted({name for name in names if names.count(name) > 1})
            require(not twice, key, "names and labels must differ", twice)
        labels = [e.name for e in self.estimators]
        if self.vertices is not None:
            known, chosen = ", ".join(labels), self.vertices.reference
            require(chosen in labels, "vertices.reference", f"expected a label among {known}", chosen)
        if self.peers:
            for number, scene in enumerate(self.scenes):
                readable = scene.file.lower().endswith(".xml")
                require(readable, f"scenes[{number}].file", "peers read Mitsuba XML files only", scene.file)
                place, kind = f"scenes[{number}].motion.kind", scene.motion.kind
                require(kind != "vertices", place, "peers know translate and rotate only", kind)


def chart_config(table: dict, path: Path) -> ChartConfig:
    """The config in a TOML table that was read from `path`. Files are looked for in the config's `folder`.

    Raises ValueError, with the file, the key and what was expected.
    """
    config = build(ChartConfig, table, str(path))
    scenes = []
    for number, scene in enumerate(config.scenes):
        place, motion, reference = f"scenes[{number}]", scene.motion, scene.reference

        def found(key, name, kind, place=place):
            return found_file(path, f"{place}.{key}", str(Path(config.folder) / name), kind) if name else ""

        motion = dataclasses.replace(
            motion, velocities=found("motion.velocities", motion.velocities, "a .npy file of velocities")
        )
        if isinstance(reference, Stored):
            file = found("reference.file", reference.file, "a derivative image (.npy)")
            reference = dataclasses.replace(reference, file=file)
        file = found("file", scene.file, "a scene file")
        scenes.append(dataclasses.replace(scene, motion=motion, reference=reference, file=file))
    return dataclasses.replace(config, scenes=tuple(scenes))


def _check_ladder(samples: tuple[int, ...], key: str = "samples") -> None:
    good = all(count >= 1 for count in samples) and list(samples) == sorted(set(samples))
    require(good, key, "must be increasing counts, at least 1", list(samples))
