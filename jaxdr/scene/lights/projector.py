"""A projector: a light at a point that throws an image into the scene."""

import math
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_array
from jaxdr.geometry.vector import components, scale, transform, z_of
from jaxdr.scene.camera import Perspective
from jaxdr.scene.camera.base import checked_pose, concrete
from jaxdr.scene.camera.pinhole import FOV, FOV_AXES
from jaxdr.scene.color import magnitude
from jaxdr.scene.film import Film
from jaxdr.scene.lights.base import DeltaLight
from jaxdr.scene.ranges import floats, ranged

WRAPS = ("clamp", "repeat")


@checked
class Projector(DeltaLight):
    """A pinhole camera in reverse: it throws an image [H, W, 3] along +z of its frame, with x to the left and y up.

    `to_world` [4, 4] has no scale. `fov` is in degrees along `fov_axis`, as for `Perspective`. A white diffuse screen
    across the axis at distance 1 has the radiance `scale` x `irradiance`. (That is Mitsuba's convention: the true
    irradiance is pi times that.) Values are interpolated between texel centres. `wrap` says how the image goes on
    beyond the outer centres: "clamp", or "repeat" (Mitsuba's default, which mixes opposite borders within half a
    texel).

    Raises ValueError for an image that is not RGB or is empty, an unknown `wrap` or axis, another shape of a parameter,
    and for a `to_world` that scales, shears, or can't be inverted.
    """

    irradiance: Float[Array, "H W 3"]
    to_world: Float[Array, "4 4"]
    fov: Float[Array, ""] = eqx.field(metadata=ranged(*FOV, open=True, unit="degrees"))
    scale: Float[Array, ""]
    fov_axis: str = eqx.field(static=True)
    wrap: Literal["clamp", "repeat"] = eqx.field(static=True)
    stackable = False

    def __init__(
        self,
        irradiance: ArrayLike,
        to_world: ArrayLike,
        fov: ArrayLike,
        scale: ArrayLike = 1.0,
        fov_axis: str = "x",
        wrap: Literal["clamp", "repeat"] = "clamp",
    ):
        self.irradiance = as_array(floats(irradiance, "Projector: irradiance"))
        self.to_world, self.fov, self.scale = (as_array(value) for value in (to_world, fov, scale))
        self.fov_axis, self.wrap = fov_axis, wrap
        if self.irradiance.ndim != 3 or self.irradiance.shape[2] != 3 or not self.irradiance.size:
            raise ValueError(f"Projector: irradiance must be an RGB image [H, W, 3], got {self.irradiance.shape}")
        if self.fov.shape != () or self.scale.shape != ():
            raise ValueError("Projector: fov and scale must be numbers")
        if fov_axis not in FOV_AXES or wrap not in WRAPS:
            raise ValueError(
                f"Projector: fov_axis must be one of {', '.join(FOV_AXES)}, wrap one of {', '.join(WRAPS)}; "
                f"got {fov_axis!r} and {wrap!r}"
            )

    def check_together(self):
        pose = concrete(checked_pose("Projector", self.to_world, scales=False))
        if pose is not None and not np.allclose(np.linalg.det(pose[:3, :3]), 1.0, atol=1e-3):
            raise ValueError(f"Projector: to_world must not scale, got {pose.tolist()}")

    @property
    def camera(self) -> Perspective:
        """The pinhole camera that this projector reverses. Its pixels are the texels of the image."""
        height, width, _ = self.irradiance.shape
        return Perspective(self.to_world, self.fov, Film(width, height), self.fov_axis)

    def place(self):
        return self.to_world[:3, 3]

    def intensity_in(self, direction):
        height, width, _ = self.irradiance.shape
        local = transform(self.to_world[:3, :3].T, direction)
        ahead = z_of(local) > 0
        local = jnp.where(ahead[..., None], local, jnp.asarray([0.0, 0.0, 1.0], local.dtype))
        point = self.camera.project_local(local)
        size = jnp.asarray([width, height], point.dtype)
        inside = ahead & ((point >= 0) & (point <= size)).all(-1)
        value = bilinear(self.irradiance, jnp.where(inside[..., None], point, 0.5 * size), self.wrap)
        # The image is per area of the screen at distance 1; that area times cos^3 is a solid angle.
        value = scale(value, math.pi * self.scale / z_of(local) ** 3)
        return jnp.where(inside[..., None], value, 0.0)

    def power(self, radius):
        del radius
        height, width, _ = self.irradiance.shape
        area = width * height / self.camera.pixels_per_tangent**2
        return math.pi * area * jnp.abs(self.scale) * magnitude(self.irradiance).mean()

    def sample(self, u):
        height, width, _ = self.irradiance.shape
        point = u * jnp.asarray([width, height], u.dtype)
        return stop_gradient(self.camera.view().rays(point)[1])

    def pdf(self, direction):
        height, width, _ = self.irradiance.shape
        camera = stop_gradient(self.camera)
        local = stop_gradient(direction) @ camera.to_world[:3, :3]
        ahead = z_of(local) > 0
        local = jnp.where(ahead[..., None], local, jnp.asarray([0.0, 0.0, 1.0], local.dtype))
        point = camera.project_local(local)
        inside = ahead & ((point >= 0) & (point <= jnp.asarray([width, height], point.dtype))).all(-1)
        density = camera.pixels_per_tangent**2 / (width * height * z_of(local) ** 3)
        return jnp.where(inside, density, 0.0)

    def borders(self):
        height, width, _ = self.irradiance.shape
        film = jnp.asarray([[0, 0], [0, height], [width, height], [width, 0], [width / 2, height / 2]])
        tangent = (film[4] - film.astype(self.fov.dtype)) / self.camera.pixels_per_tangent
        local = jnp.concatenate([tangent, jnp.ones_like(tangent[:, :1])], -1)
        points = local @ self.to_world[:3, :3].T
        corners, centre = points[:4], points[4:]
        return jnp.stack([corners, jnp.roll(corners, -1, axis=0), jnp.broadcast_to(centre, (4, 3))], 1)


def bilinear(image: Float[Array, "H W 3"], point: Float[Array, "*n 2"], wrap: str) -> Float[Array, "*n 3"]:
    """Values of an image at points, in texels from its top left. `wrap` says what lies beyond the outer centres."""
    height, width, _ = image.shape
    low = jnp.floor(stop_gradient(point) - 0.5)
    along = point - 0.5 - low
    column, row = (part.astype(jnp.int32) for part in components(low))
    columns, rows = (_wrapped(c, n, wrap) for c, n in ((column, width), (row, height)))
    table, (a, b) = image.reshape(-1, 3), components(along)
    upper, lower = (
        scale(table[row * width + columns[0]], 1 - a) + scale(table[row * width + columns[1]], a) for row in rows
    )
    return scale(upper, 1 - b) + scale(lower, b)


def _wrapped(index, count: int, wrap: str):
    both = (index, index + 1)
    return tuple(jnp.mod(i, count) if wrap == "repeat" else jnp.clip(i, 0, count - 1) for i in both)
