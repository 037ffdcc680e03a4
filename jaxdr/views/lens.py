"""Lenses as files describe them, in COLMAP's terms, and the pinholes to which photographs are resampled."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxdr.scene.camera.pinhole import FOV_COMPUTED
from jaxdr.untrusted import MOST_PIXELS, damage, finite, shortened

# Focal lengths along x and y may differ by this share: less than a tenth of a pixel at the border of a large picture.
SQUARE = 1e-3
PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
# Models with one focal length; f, cx, cy come first. The others begin with fx, fy, cx, cy.
ONE_FOCAL = (
    *("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
    *("SIMPLE_DIVISION", "SIMPLE_FISHEYE"),
)
PANORAMA = "EQUIRECTANGULAR"
WIDEST = 150.0  # degrees: no pinhole is made wider than this of a fisheye
ROUNDED = 1.0  # pixels by which a picture's side may miss that of the camera, scaled to its size


class Pinhole(NamedTuple):
    """The camera of a resampled photograph: size, one focal length, and principal point (x, y), in its own pixels."""

    width: int
    height: int
    focal: float
    centre: tuple[float, float]


@dataclass(frozen=True)
class Lens:
    """How a camera maps directions to pixels.

    - `model`, `parameters`: name and numbers as COLMAP has them, in pixels. Where a file does not say them, the focal
      lengths or the principal point of a pinhole are None.
    - `width`, `height`: of its pictures, in pixels; 0 where a file does not say them.
    - `angle`: horizontal field of view (radians), in place of focal lengths.
    """

    model: str
    parameters: tuple[float | None, ...]
    width: int = 0
    height: int = 0
    angle: float | None = None

    @classmethod
    def pinhole(cls, focal: tuple[float, float] | float, centre=(None, None), size=(0, 0)) -> "Lens":
        """A lens without distortion; `focal` along x and y, in pixels."""
        fx, fy = focal if isinstance(focal, tuple) else (focal, focal)
        return cls("PINHOLE", (fx, fy, *centre), *size)

    @property
    def straight(self) -> bool:
        """Whether it keeps straight lines straight."""
        return self.model in PINHOLES

    @property
    def focal(self) -> tuple[float, float]:
        """Focal lengths along x and y, in pixels."""
        values: Any = self.parameters
        return (values[0], values[0]) if self.model in ONE_FOCAL else (values[0], values[1])

    @property
    def centre(self) -> tuple[float, float]:
        """Principal point (x, y), in pixels."""
        values: Any = self.parameters
        return (values[1], values[2]) if self.model in ONE_FOCAL else (values[2], values[3])

    def of_picture(self, width: int, height: int, source: str, name: str) -> "Lens":
        """The lens for a picture of this size, with nothing left open.

        A picture may be the camera's, made smaller or larger as a whole. Raises ValueError, with `source` and the
        picture's `name`, for one of another shape, and for a lens that is impossible.
        """
        if self.model == PANORAMA:
            raise ValueError(f"{source}: {name} is a panorama ({self.model}); project it to pinholes first")
        lens = self._measured(width, height)
        fx, fy = lens.focal
        shortest, longest = (0.5 * lens.width / np.tan(0.5 * np.radians(angle)) for angle in reversed(FOV_COMPUTED))
        if not (shortest <= fx <= longest and shortest <= fy <= longest):
            raise ValueError(
                f"{source}: the focal length must be from {shortest:.3g} to {longest:.3g} pixels, got "
                f"{shortened(f'an angle of {self.angle}' if self.angle is not None else (fx, fy))}; give it in pixels"
            )
        for value in lens.centre:
            finite(value, f"{source}: the principal point", -MOST_PIXELS, MOST_PIXELS)
        if (lens.width, lens.height) == (width, height):
            return lens
        share = width / lens.width
        if not alike((lens.width, lens.height), (width, height)):
            side, told, found = "width", lens.width, width
            if told == found:
                side, told, found = "height", lens.height, height
            raise ValueError(
                f"{source}: says {side} {told}, {name} has {found} pixels; scale the pictures or the camera"
            )
        return lens._scaled(share, height / lens.height, width, height)

    def _measured(self, width: int, height: int) -> "Lens":
        """With what the file does not say, from the picture."""
        lens = replace(self, width=self.width or width, height=self.height or height)
        if not self.straight:
            return lens
        focal: Any = self.parameters[:-2]
        if self.angle is not None:
            length = 0.5 * lens.width / np.tan(0.5 * self.angle) if 0 < self.angle < np.pi else 0.0
            focal = (length,) * len(focal)
        x, y = self.parameters[-2:]
        centre = lens.width / 2 if x is None else float(x), lens.height / 2 if y is None else float(y)
        return replace(lens, parameters=(*(float(f) for f in focal), *centre), angle=None)

    def _scaled(self, along_x: float, along_y: float, width: int, height: int) -> "Lens":
        if self.straight:
            (fx, fy), (x, y) = self.focal, self.centre
            return Lens("PINHOLE", (fx * along_x, fy * along_y, x * along_x, y * along_y), width, height)
        camera = self._of_pycolmap()
        camera.rescale(width, height)
        return replace(self, parameters=tuple(camera.params.tolist()), width=width, height=height)

    @lru_cache(maxsize=256)  # noqa: B019 - lenses are few, frozen and small
    def target(self, longest: int | None = None) -> tuple["Lens", Pinhole]:
        """(this lens without distortion, the pinhole to which its pictures are resampled).

        The pinhole's pixels are square, and its picture shows nothing that the photograph does not. It has at most
        `longest` pixels along its longer side, and is never finer than the photograph. Raises ImportError without
        pycolmap if there is distortion, and ValueError for a panorama.
        """
        straight = self if self.straight else self._straightened()
        (fx, fy), (x, y) = straight.focal, straight.centre
        width, height = straight.width, straight.height
        if abs(fx / fy - 1) <= SQUARE and (longest is None or max(width, height) <= longest):
            return straight, Pinhole(width, height, float(np.sqrt(fx * fy)), (x, y))
        focal = min(fx, fy)
        if longest is not None:
            focal *= min(1.0, longest / max(width * focal / fx, height * focal / fy))
        along_x, along_y = focal / fx, focal / fy
        # A pixel that the photograph covers only in part is left out.
        width, height = (max(1, int(side * share + 1e-6)) for side, share in ((width, along_x), (height, along_y)))
        return straight, Pinhole(width, height, float(focal), (x * along_x, y * along_y))

    def _straightened(self) -> "Lens":
        pycolmap = require_pycolmap()
        options = pycolmap.UndistortCameraOptions()
        options.max_cam_point_norm = float(np.tan(np.radians(WIDEST / 2)))
        with damage(f"distortion of a {self.model} lens can't be taken away; calibrate it anew"):
            camera = pycolmap.undistort_camera(options, self._of_pycolmap())
        return Lens("PINHOLE", tuple(camera.params.tolist()), camera.width, camera.height)

    def _of_pycolmap(self):
        pycolmap = require_pycolmap()
        return pycolmap.Camera(model=self.model, width=self.width, height=self.height, params=list(self.parameters))

    def project(self, directions: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 2"]:
        """Pixels (x to the right, y down; the first centre is at .5) of directions: x to the right, y down, z ahead."""
        if self.straight:
            return directions[:, :2] / directions[:, 2:] * np.array(self.focal) + np.array(self.centre)
        return np.asarray(self._of_pycolmap().img_from_cam(directions))

    def directions(self, pixels: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        """What pixels see, as x and y of directions with z = 1: the other way round than `project`."""
        if self.straight:
            return (pixels - np.array(self.centre)) / np.array(self.focal)
        return np.asarray(self._of_pycolmap().cam_from_img(pixels))


def alike(told: tuple[int, int], found: tuple[int, int]) -> bool:
    """Whether two sizes have one shape, up to rounding of the smaller one."""
    share = max(found) / max(told)
    return all(abs(there - here * share) <= ROUNDED * max(1.0, share) for here, there in zip(told, found, strict=True))


def require_pycolmap():
    """pycolmap. Raises ImportError, which says how to install it."""
    try:
        import pycolmap
    except ImportError as missing:
        raise ImportError(
            'lens distortion needs pycolmap, which is optional: pip install -e ".[reconstruct]"'
        ) from missing
    return pycolmap
