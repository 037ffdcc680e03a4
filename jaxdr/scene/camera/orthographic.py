"""Camera without perspective."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.scene.camera.base import FAR_CLIP, NEAR_CLIP, Camera, checked_clip, checked_pose
from jaxdr.scene.camera.view import ParallelView
from jaxdr.scene.film import Film


@checked
class Orthographic(Camera):
    """A camera with parallel rays. It looks along +z of its frame, x to the left, y up, as in Mitsuba.

    The film covers x from -1 to 1 in the frame, and y in proportion to its height. `to_world` [4, 4] (camera to world)
    may scale each axis by its own factor. The scale says how much of the world the film shows.

    Nothing is seen that is nearer than `near_clip` or farther than `far_clip` along the axis (units of the frame).
    Where planes of your own cut surfaces, the cut is an edge of the image. Default planes should cut none.

    Raises ValueError for a matrix that can't be inverted, and unless 0 < near_clip < far_clip.
    """

    to_world: Float[Array, "4 4"]
    film: Film
    near_clip: float = eqx.field(static=True)
    far_clip: float = eqx.field(static=True)
    aperture = False

    def __init__(self, to_world: ArrayLike, film: Film, near_clip: float = NEAR_CLIP, far_clip: float = FAR_CLIP):
        self.to_world = checked_pose("Orthographic", to_world, scales=True)
        self.film = film
        self.near_clip, self.far_clip = checked_clip("Orthographic", near_clip, far_clip)

    def check_together(self):
        checked_pose("Orthographic", self.to_world, scales=True)

    def view(self, u=None) -> ParallelView:
        axes, position = self.to_world[:3, :3], self.to_world[:3, 3]
        pixels = jnp.asarray(0.5 * self.film.width, axes.dtype)
        centre = jnp.asarray([0.5 * self.film.width, 0.5 * self.film.height], axes.dtype)
        return ParallelView(axes, position, pixels, centre, self.film, self.near_clip, self.far_clip)
