"""Light that reaches the first hit from close by, where a fixed camera ray is the wrong form.

With the camera ray fixed, the first hit slides over its surface, and all later vertices are material points. If one of
them is close (in a fold of the surface, in contact), the geometric term changes by slide / distance: a derivative
without finite variance. A first hit in material form moves with what is near it. But it needs the derivative of the
pixel filter, which is noisy for all light: the noise is 1 / s, with s the filter's width at the first hit. On a fixed
ray the first hit slides 1 / cosine times as far as the surface moves, so the noise is 1 / (d cosine) for light from the
distance d.

So light is split. A share s^2 / (s^2 + (d cosine)^2) is taken in material form, the rest with the ray fixed. The shares
add up to one. Each is a smooth function of the scene, except for a jump of the normal from face to face, which creases
account for. Both forms estimate the same derivative, so the sum is unbiased. Its terms are bounded by 1 / s. The filter
must be smooth or constant on its pixel (`boundary.film.pixel_borders`). Only indirect light is split.
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

    `importance` is one in value. Its derivative is that of W_e G J (filter, geometric term, Jacobian) over its value.
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
        """Share of the light from `target` that is taken in material form; `point` has either form."""
        offset = target - point.position
        distance2 = jnp.where(infinite, 1.0, dot(offset, offset))
        return jnp.where(infinite, 0.0, footprint(self.camera, point.position, point.normal).share(distance2))


class Footprint(NamedTuple):
    """The footprint of a pixel at points in the scene.

    `size2` is the squared standard deviation of the filter there, across the ray. `cosine2` is the squared cosine
    between ray and normal.
    """

    size2: Float[Array, "*n"]
    cosine2: Float[Array, "*n"]

    def share(self, distance2: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """s^2 / (s^2 + (d cosine)^2); zero where `size2` is zero."""
        whole = self.size2 + self.cosine2 * distance2
        return safe_divide(self.size2, whole, otherwise=0.0)


def footprint(camera: View, position: Float[Array, "*#n 3"], normal: Float[Array, "*#n 3"]) -> Footprint:
    """Footprint of a pixel, at points with the unit normals `normal`."""
    stddev = camera.film.filter.stddev
    return Footprint((stddev * camera.pixel_size(position)) ** 2, dot(normal, camera.towards(position)) ** 2)


def film_importance(camera: View, point: SurfacePoint, centre: Float[Array, "N 2"]) -> Float[Array, " N"]:
    """W_e G J over its detached value at moving material points (Xu et al. 2026, Eq. 2-4); `centre`: of their pixels.

    If W_e is constant on a pixel, its derivative is the flux through the border, which is not counted here.
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
