"""Light that reaches the first hit from close by, where a fixed camera ray is the wrong form.

With the camera ray fixed, the first hit slides over its surface, and everything behind it stays a material point. Where
that comes close (in a fold of the surface, in contact), the geometric term changes by slide / distance: a derivative
without finite variance. A material first hit moves along with what is near it, but needs the derivative of the pixel
filter, which is noisy for all light. So light is split by the length of the second segment: a share
s^2 / (s^2 + d^2), with s the size of a pixel at the first hit, is taken in material form, the rest with the ray fixed.
The shares add up to one, each is a smooth function of the scene, and both forms estimate the same derivative, so the
sum is unbiased; its terms are bounded by 1 / s. Only filters with a smooth derivative allow it, and only indirect light
is worth it.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import dot, normalize
from jaxdr.scene.camera import Perspective
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint


class NearField(NamedTuple):
    """First hits in material form.

    `importance` is one in value, its derivative that of W_e G J: what the filter makes of the moving projection.
    """

    camera: Perspective
    point: SurfacePoint
    importance: Float[Array, " N"]

    @property
    def wi(self) -> Float[Array, "N 3"]:
        """Directions to the camera; they turn as the points move."""
        return normalize(self.camera.position - self.point.position)

    def share(
        self, point: SurfacePoint, target: Float[Array, "N 3"], infinite: Bool[Array, " N"]
    ) -> Float[Array, " N"]:
        """Share of the light from `target` that is taken in material form, as seen from either form's `point`."""
        size2 = footprint2(self.camera, point.position)
        offset = target - point.position
        return jnp.where(infinite, 0.0, near_share(size2, jnp.where(infinite, 1.0, dot(offset, offset))))


def footprint2(camera: Perspective, position: Float[Array, "N 3"]) -> Float[Array, " N"]:
    """Squared size of a pixel at points in the scene (across the ray)."""
    offset = position - camera.position
    return dot(offset, offset) / camera.pixels_per_tangent**2


def near_share(size2: Float[Array, " N"], distance2: Float[Array, " N"]) -> Float[Array, " N"]:
    """s^2 / (s^2 + d^2)."""
    return size2 / (size2 + distance2)


def film_importance(packed: PackedScene, point: SurfacePoint, centre: Float[Array, "N 2"]) -> Float[Array, " N"]:
    """W_e G J over its detached value at moving material points; `centre` of their pixels (kernel density, Eq. 2-4)."""
    camera = packed.camera
    local = camera.local(point.position)
    depth = jnp.where(point.valid, local[:, 2], 1.0)
    local = jnp.concatenate([local[:, :2], depth[:, None]], -1)
    importance = camera.film.filter.pdf(camera.project_local(local) - centre)
    # Film area per surface area: |n . (x - o)| / depth^3, times the squared focal length.
    projected = jnp.abs(dot(point.normal, point.position - camera.position)) / depth**3
    value = importance * projected * camera.pixels_per_tangent**2 * point.area_ratio()
    detached = stop_gradient(value)
    return jnp.where(detached > 0, value / jnp.where(detached > 0, detached, 1.0), 1.0)
