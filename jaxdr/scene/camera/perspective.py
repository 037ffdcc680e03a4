"""Pinhole camera."""

from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.scene.camera.base import FAR_CLIP, NEAR_CLIP
from jaxdr.scene.camera.pinhole import PinholeCamera
from jaxdr.scene.film import Film


@checked
class Perspective(PinholeCamera):
    """A pinhole camera. It looks along +z of its frame, x to the left, y up, as in Mitsuba.

    - `to_world` [4, 4]: camera to world; rotation, translation and uniform scale. `look_at` makes one.
    - `fov`: field of view in degrees along `fov_axis`.
    - `principal_point` [2]: moves the image to the left and up, by shares of the film's width and height (Mitsuba's
      `principal_point_offset_x`, `_y`).
    - `near_clip`, `far_clip`: nothing nearer or farther along the axis is seen (units of the frame).
      Where planes of your own cut surfaces, the cut is an edge of the image. Default planes should cut none.

    Raises ValueError for a matrix that shears, fov outside (0, 180), an unknown `fov_axis`, a `principal_point` that is
    not two numbers, and unless 0 < near_clip < far_clip.
    """

    aperture = False

    def __init__(
        self,
        to_world: ArrayLike,
        fov: ArrayLike,
        film: Film,
        fov_axis: str = "x",
        near_clip: float = NEAR_CLIP,
        far_clip: float = FAR_CLIP,
        principal_point: ArrayLike = (0.0, 0.0),
    ):
        super().__init__(to_world, fov, film, fov_axis, near_clip, far_clip, principal_point)
