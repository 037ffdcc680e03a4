"""Camera with a lens: depth of field."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_array
from jaxdr.geometry.vector import dot, norm, z_of
from jaxdr.scene.camera.base import FAR_CLIP, NEAR_CLIP
from jaxdr.scene.camera.pinhole import PinholeCamera
from jaxdr.scene.camera.view import PinholeView
from jaxdr.scene.film import Film
from jaxdr.scene.ranges import at_least, ranged
from jaxdr.scene.sampling import uniform_disk

NEAREST = 1e-3  # least focus distance, of the near clip


@checked
class ThinLens(PinholeCamera):
    """A `Perspective` camera with a lens: sharp at the depth `focus_distance`, blurred elsewhere.

    The lens is a disk across the axis, of radius `aperture_radius`. Both lengths are in units of the camera's frame,
    and parameters of the scene. The other parameters are those of a `Perspective` camera at the centre of the lens.
    Each sample sees through one point of the lens, drawn uniformly in area (Mitsuba's `thinlens`; Cook et al. 1984).
    That point stays fixed on the lens as the radius changes. A larger aperture does not make the image brighter.

    Raises ValueError as `Perspective` does, and unless radius and distance are positive.
    """

    aperture_radius: Float[Array, ""] = eqx.field(
        metadata=ranged(0.0, math.inf, open=True, remedy="without an aperture take Perspective")
    )
    focus_distance: Float[Array, ""] = eqx.field(metadata=ranged(0.0, math.inf, open=True))
    aperture = True

    def __init__(
        self,
        to_world: ArrayLike,
        fov: ArrayLike,
        film: Film,
        aperture_radius: ArrayLike,
        focus_distance: ArrayLike,
        fov_axis: str = "x",
        near_clip: float = NEAR_CLIP,
        far_clip: float = FAR_CLIP,
        principal_point: ArrayLike = (0.0, 0.0),
    ):
        super().__init__(to_world, fov, film, fov_axis, near_clip, far_clip, principal_point)
        self.aperture_radius = as_array(aperture_radius)
        self.focus_distance = as_array(focus_distance)
        for name in ("aperture_radius", "focus_distance"):
            if (shape := getattr(self, name).shape) != ():
                raise ValueError(f"ThinLens: {name} must be a number, got shape {shape}")

    def view(self, u=None) -> PinholeView:
        central = super().view()
        if u is None:
            return central
        # A pinhole at the lens point. Its image is shifted so that points at the depth of focus stay in place.
        lens = self.aperture_radius * uniform_disk(u)
        position = central.position + lens @ central.matrix[:, :2].T
        centre = central.centre - central.pixels * lens / self._focus()
        return PinholeView(central.matrix, position, central.pixels, centre, self.film, self.near_clip, self.far_clip)

    def blur(self, local):
        reach = self.pixels_per_tangent * self.aperture_radius
        return reach * (1.0 / z_of(local) - 1.0 / self._focus())

    def _focus(self) -> Float[Array, ""]:
        """The focus distance; for traced values at least a small share of what the camera can see."""
        return at_least(self.focus_distance, NEAREST * self.near_clip)

    def turns(self, points, normal):
        # A surface turns where its plane meets the lens: the distance of the centre from the plane is no more than the
        # largest change of that distance over the lens.
        height = dot(points - self.position, normal)
        return jnp.abs(height) <= self.aperture_radius * norm(normal @ self.to_world[:3, :2])
