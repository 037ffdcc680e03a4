"""What `jaxdr reconstruct` can be told: frozen dataclasses, one a TOML table. All of it has defaults.

Lengths are relative to the object: its longest side, at the start, is 1.
"""

import dataclasses
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Literal

from jaxdr.optimize.config import Integrator
from jaxdr.optimize.config_checks import at_least, check_run, not_negative, positive, require
from jaxdr.optimize.strict_toml import build


@dataclass(frozen=True)
class Start:
    """The first surface.

    - `kind`: "hull" is the visual hull of the masks. "sphere" is a sphere around the point at which the cameras look.
      "auto" is the hull where there are masks.
    - `grid`: cells of the hull's grid along its longest side.
    - `stereo`: look for points of the object in pairs of photographs. Where many are deep under the first surface,
      it is carved and moved to them.
    """

    kind: Literal["auto", "hull", "sphere"] = "auto"
    grid: int = 96
    stereo: bool = True

    def __post_init__(self):
        require(16 <= self.grid <= 512, "grid", "must be between 16 and 512", self.grid)


@dataclass(frozen=True)
class Priors:
    """Weights of what is expected beside the photographs; 0 leaves one out.

    - `mask`: squared difference of coverage and mask: pins the outline where object and background look alike.
    - `albedo`: colours of neighbouring vertices differ little, or rarely: fills in what no photograph shows.
    - `light`: neighbouring directions send alike light: a dull surface does not tell them apart.
    - `white`: the light is about grey: of the product of light and albedo the photographs see only one colour.
    - `background`: the light is what the photographs show behind the object, where all of them agree on it.
    - `cameras`: cameras are about where they are said to be: object and cameras could move together, and no photograph
      would change.
    - `points`: the surface is where photographs saw points of the object, sparse ones of a COLMAP model or of stereo.
    """

    mask: float = 1.0
    albedo: float = 0.02
    light: float = 0.0002
    white: float = 0.02
    background: float = 0.1
    cameras: float = 0.1
    points: float = 10.0

    def __post_init__(self):
        not_negative(self)


@dataclass(frozen=True)
class Rates:
    """Step sizes at the start; all fall to the share `final` of them, exponentially, until the end.

    `vertices` is that of `adam_uniform` on the latent coordinates of `LargeSteps`. It is a fifth of that where points
    hold the surface: then it starts about right. The others are those of Adam, on logits of albedo and roughness, on
    logarithms of light and exposure, and on corrections of cameras (radians, and shares of the longest side).
    """

    vertices: float = 0.05
    albedo: float = 0.05
    roughness: float = 0.05
    light: float = 0.1
    exposure: float = 0.01
    cameras: float = 0.0015
    final: float = 0.1

    def __post_init__(self):
        positive(self)


@dataclass(frozen=True)
class Level:
    """A stage from coarse to fine.

    - `steps`: how many.
    - `resolution`: pixels along the longer side of the photographs, and never more than they have.
    - `vertices`: of the mesh. `lam`: strength of its preconditioner.
    - `sky`: rows of the sky.
    - `views`: how many go into the gradient of a step.
    - `texture`: width of a texture of the albedo, in texels; with 0 the albedo is at the vertices.
    """

    steps: int
    resolution: int
    vertices: int
    views: int = 2
    lam: float = 4.0
    sky: int = 17
    texture: int = 0

    def __post_init__(self):
        if self.texture:
            require(16 <= self.texture <= 8192, "texture", "must be between 16 and 8192, or 0", self.texture)
        for name, least in (("steps", 1), ("resolution", 8), ("vertices", 50), ("views", 1), ("sky", 3)):
            at_least(least, self, name)
        not_negative(self, "lam")


@dataclass(frozen=True)
class Samples:
    """Samples per pixel.

    - `image`: of the image in the loss.
    - `gradient`: of its gradient.
    - `pictures`: of the pictures of the result. Large ones get fewer, so that none has more than 2^24 samples in all,
      but at least 16 per pixel.
    """

    image: int = 4
    gradient: int = 4
    pictures: int = 256

    def __post_init__(self):
        at_least(1, self)


@dataclass(frozen=True)
class Report:
    """How often, in steps: `pictures` on the way, a `checkpoint`. `turntable`: its frames, 0 for none. `texture`: width
    of the textures of `asset.glb` that hold what was found at vertices, in pixels."""

    pictures: int = 50
    checkpoint: int = 50
    turntable: int = 24
    texture: int = 1024

    def __post_init__(self):
        at_least(1, self, "pictures", "checkpoint")
        not_negative(self, "turntable")
        require(16 <= self.texture <= 8192, "texture", "must be between 16 and 8192", self.texture)


AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}


@dataclass(frozen=True)
class Asset:
    """The frame of the asset. It stands upright on y = 0, as glTF has it.

    - `up`: a direction in the world of the cameras: an axis such as "z" or "-y", or "0,0.2,1". "auto": as people hold
      cameras.
    - `scale`: metres of a unit of this world. `height`: metres of the asset. Without both a unit stays a unit.
    """

    up: str = "auto"
    scale: float | None = None
    height: float | None = None

    def __post_init__(self):
        positive(self, "scale", "height")
        require(self.scale is None or self.height is None, "height", "can't be given with scale", self.height)
        rule = 'must be "auto", an axis such as "z" or "-y", or three numbers such as "0,0.2,1"'
        try:
            good = self.direction is None or (all(map(isfinite, self.direction)) and any(self.direction))
        except ValueError:
            good = False
        require(good, "up", rule, self.up)

    @property
    def direction(self) -> tuple[float, float, float] | None:
        """What is up, of any length; None if cameras tell."""
        if self.up == "auto":
            return None
        x, y, z = AXES[self.up] if self.up in AXES else map(float, self.up.split(","))
        return float(x), float(y), float(z)


@dataclass(frozen=True)
class Memory:
    """GiB of `pictures` that are kept in memory once they are read: half of it as they are in the files, half as levels
    need them. Others are read again each time, ahead of the steps that need them. It does not change the result."""

    pictures: float = 2.0

    def __post_init__(self):
        not_negative(self)


# From coarse to fine; a finer quality has more steps, pixels, vertices and texels.
QUALITIES: dict[str, tuple[Level, ...]] = {
    "draft": (
        Level(steps=90, resolution=100, vertices=3000, views=3, sky=17),
        Level(steps=110, resolution=200, vertices=8000, views=2, sky=33, texture=512),
    ),
    "normal": (
        Level(steps=150, resolution=100, vertices=3000, views=3, sky=17),
        Level(steps=150, resolution=200, vertices=12000, views=2, sky=33, texture=512),
        Level(steps=70, resolution=400, vertices=16000, views=2, sky=33, texture=1024),
    ),
    "high": (
        Level(steps=150, resolution=100, vertices=3000, views=3, sky=17),
        Level(steps=220, resolution=200, vertices=12000, views=2, sky=33, texture=512),
        Level(steps=200, resolution=400, vertices=30000, views=2, sky=33, texture=1024),
        Level(steps=100, resolution=800, vertices=50000, views=2, sky=33, texture=2048),
    ),
}
LEVELS = QUALITIES["normal"]
ESTIMATOR = "KernelDensity"  # of the boundary integral, also where a table changes only the depth


@dataclass(frozen=True)
class ReconstructConfig:
    """Everything about one reconstruction. The same photographs, config and seed give the same result, bit for bit on
    CPU. `unknown`: what is found beside the vertices; with "auto", exposures of photographs that differ, too.
    `holdout`: pattern of pictures that are held out, see `jaxdr.load_views`.

    `masks`: a folder of masks. "auto": those of the folder, and if there are none they are found. "none": those of the
    folder or nothing."""

    folder: str
    output: str
    holdout: str = ""
    masks: str = "auto"
    seed: int = 0
    unknown: tuple[Literal["albedo", "roughness", "light", "exposure", "cameras", "auto"], ...] = (
        "albedo",
        "roughness",
        "light",
        "auto",
    )
    start: Start = Start()
    integrator: Integrator = field(default_factory=lambda: Integrator(boundary=ESTIMATOR))
    samples: Samples = Samples()
    priors: Priors = Priors()
    rates: Rates = Rates()
    levels: tuple[Level, ...] = LEVELS
    report: Report = Report()
    memory: Memory = Memory()
    asset: Asset = Asset()

    def __post_init__(self):
        check_run(self)
        require(len(self.levels) >= 1, "levels", "there must be at least one", self.levels)
        primary = self.integrator.primary
        require(primary == "fixed_ray", "integrator.primary", 'must be "fixed_ray" with box pixels', primary)
        kind = self.integrator.kind
        require(kind == "path", "integrator.kind", 'must be "path" here', kind)
        require(
            not self.integrator.planned,
            "integrator",
            '"plan" is for `jaxdr optimize`; give max_depth and boundary',
            self.integrator,
        )

    @property
    def steps(self) -> int:
        """Steps of all levels."""
        return sum(level.steps for level in self.levels)


def reconstruct_config(
    table: dict,
    source: str,
    folder: str,
    output: str,
    holdout: str = "",
    masks: str = "",
    quality: str = "",
    asset: dict | None = None,
) -> ReconstructConfig:
    """The config of a TOML table, for these photographs. Raises ValueError that names source, key and what is expected.

    What the command line says goes before the table, also single fields of `asset`. `quality` chooses the levels, so
    the table may not have any.
    """
    said: dict[str, Any] = {"folder": folder, "output": output}
    said |= {name: value for name, value in (("holdout", holdout), ("masks", masks)) if value}
    if quality:
        require(quality in QUALITIES, "--quality", f"must be one of {', '.join(QUALITIES)}", quality)
        if "levels" in table:
            raise ValueError(f"{source}: levels: --quality chooses them, too; leave out one of both")
        said["levels"] = [dataclasses.asdict(level) for level in QUALITIES[quality]]
    if isinstance(table.get("integrator"), dict):
        said["integrator"] = {"boundary": ESTIMATOR} | table["integrator"]
    if asset:
        said["asset"] = table.get("asset", {}) | asset
    return build(ReconstructConfig, table | said, source)
