"""A photograph as a folder describes it: what is known before its picture is read."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.scene.camera.pinhole import FOV_COMPUTED
from jaxdr.untrusted import MOST_PIXELS, finite, shortened

# Focal lengths along x and y may differ by this share: less than a tenth of a pixel at the border of a large picture.
SQUARE = 1e-3


@dataclass(frozen=True, eq=False)
class Frame:
    """A photograph as a folder describes it.

    - `source`: file and entry, for messages.
    - `focal`: focal lengths along x and y, in pixels. If it is None, `angle` is the horizontal field of view (radians).
    - `centre` (x, y): principal point in pixels; `size` (width, height). None stands for what the picture says.
    """

    path: Path
    mask: Path | None
    to_world: Float[np.ndarray, "4 4"]
    source: str
    focal: tuple[float, float] | None = None
    angle: float = 0.0
    centre: tuple[float | None, float | None] = (None, None)
    size: tuple[int | None, int | None] = (None, None)
    held_out: bool = False

    def lens(self, width: int, height: int) -> tuple[float, tuple[float, float]]:
        """(focal length, principal point), in pixels of a picture of this size.

        Raises ValueError, with the source, if the camera has another size, or if the lens is impossible.
        """
        for name, told, found in zip(("width", "height"), self.size, (width, height), strict=True):
            if told is not None and told != found:
                raise ValueError(
                    f"{self.source}: says {name} {told}, {self.path.name} has {found} pixels; "
                    "scale the pictures or the camera"
                )
        fx, fy = self._focal(width)
        shortest, longest = (0.5 * width / np.tan(0.5 * np.radians(angle)) for angle in reversed(FOV_COMPUTED))
        if not (shortest <= fx <= longest and shortest <= fy <= longest):
            raise ValueError(
                f"{self.source}: the focal length must be from {shortest:.3g} to {longest:.3g} pixels, got "
                f"{shortened(self.focal or f'an angle of {self.angle}')}; give it in pixels"
            )
        if abs(fx / fy - 1) > SQUARE:
            raise ValueError(
                f"{self.source}: pixels that are not square (focal lengths {fx:.6g} and {fy:.6g}) are not supported; "
                "resize the pictures"
            )
        x, y = self.centre
        centre = width / 2 if x is None else float(x), height / 2 if y is None else float(y)
        for value in centre:
            finite(value, f"{self.source}: the principal point", -MOST_PIXELS, MOST_PIXELS)
        return float(np.sqrt(fx * fy)), centre

    def _focal(self, width: int) -> tuple[float, float]:
        if self.focal is not None:
            return self.focal
        focal = 0.5 * width / np.tan(0.5 * self.angle) if 0 < self.angle < np.pi else 0.0
        return focal, focal


def checked_pose(matrix, source: str) -> Float[np.ndarray, "4 4"]:
    """A camera-to-world matrix without scale, from [3, 4] or [4, 4]. Raises ValueError, with the source, otherwise."""
    rows = matrix.tolist() if isinstance(matrix, np.ndarray) else matrix
    if not (isinstance(rows, list) and len(rows) in (3, 4) and all(isinstance(r, list) and len(r) == 4 for r in rows)):
        raise ValueError(f"{source}: transform_matrix must be 4 x 4 finite numbers; write the pose anew")
    pose = np.array([[finite(value, f"{source}: transform_matrix") for value in row] for row in rows])
    if len(pose) == 3:
        pose = np.vstack([pose, [0, 0, 0, 1]])
    axes = pose[:3, :3]
    is_rotation = np.allclose(axes.T @ axes, np.eye(3), atol=1e-3) and np.linalg.det(axes) > 0
    if not (is_rotation and np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6)):
        raise ValueError(f"{source}: the pose must be a rotation and a translation (no scale, no mirror); normalise it")
    return pose
