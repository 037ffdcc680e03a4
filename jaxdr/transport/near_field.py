"""Light that reaches the first hit from close by, where a fixed camera ray is the wrong form.

With the camera ray fixed, the first hit slides over its surface, and everything behind it stays a material point. Where
that comes close (in a fold of the surface, in contact), the geometric term changes by slide / distance: a derivative
without finite variance. A material first hit moves along with what is near it, but needs the derivative of the pixel
filter, which is noisy for all light: one over the filter's width s at the first hit. A fixed ray's first hit slides
1 / cosine times as far as the surface moves, so that its noise is 1 / (d cosine) for light from distance d. So light is
split: a share s^2 / (s^2 + (d cosine)^2) is taken in material form, the rest with the ray fixed. The shares add up to
one, each is a smooth function of the scene (but for a jump with the normal from face to face, which creases count), and
both forms estimate the same derivative, so the sum is unbiased; its terms are bounded by 1 / s. Filters allow it that
have a smooth derivative or are constant on their pixel (`boundary.film.pixel_borders`), and only indirect light is
worth it.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import components, dot, from_components
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.camera import View
from jaxdr.transport.interaction import SurfacePoint


class NearField(NamedTuple):
    """First hits in material form, as `camera` sees them.

    `importance` is one in value, its derivative that of W_e G J: what the filter makes of the moving projection.
    """

    camera: View
    point: SurfacePoint
    importance: Float[Array, " N"]

    @property
    def wi(self) -> Float[Array, "N 3"]:
        """Directions to the camera; they turn as the points move."""
        return self.camera.towards(self.point.position)

    def share(
        self, point: SurfacePoint, target: Float[Array, "N 3"], infinite: Bool[Array, " N"]
    ) -> Float[Array, " N"]:
        """Share of the light from `target` that is taken in material form, as seen from either form's `point`."""
        offset = target - point.position
        distance2 = jnp.where(infinite, 1.0, dot(offset, offset))
        return jnp.where(infinite, 0.0, footprint(self.camera, point.position, point.normal).share(distance2))


class Footprint(NamedTuple):
    """What a pixel sees at points in the scene: `size2`, the squared standard deviation of the filter there (across the
    ray), and `cosine2`, squared, between ray and normal."""

    size2: Float[Array, "*n"]
    cosine2: Float[Array, "*n"]

    def share(self, distance2: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """s^2 / (s^2 + (d cosine)^2); zero where `size2` is."""
        whole = self.size2 + self.cosine2 * distance2
        return safe_divide(self.size2, whole, otherwise=0.0)


def footprint(camera: View, position: Float[Array, "*#n 3"], normal: Float[Array, "*#n 3"]) -> Footprint:
    """Footprint of a pixel, at points with the unit normals `normal`."""
    stddev = camera.film.filter.stddev
    return Footprint((stddev * camera.pixel_size(position)) ** 2, dot(normal, camera.towards(position)) ** 2)


def film_importance(camera: View, point: SurfacePoint, centre: Float[Array, "N 2"]) -> Float[Array, " N"]:
    """W_e G J over its detached value at moving material points; `centre` of their pixels (kernel density, Eq. 2-4).

    Where W_e is constant on a pixel, its derivative is the flux through the border, which is not counted here.
    """
    local = camera.local(point.position)
    x, y, depth = components(local)
    local = from_components(x, y, jnp.where(point.valid, depth, 1.0))
    importance = 1.0
    if camera.film.filter.smooth:
        importance = camera.film.filter.pdf(camera.project_local(local) - centre)
    value = importance * camera.film_area(local, point.normal) * point.area_ratio()
    detached = stop_gradient(value)
    return safe_divide(value, detached, detached > 0, 1.0)
