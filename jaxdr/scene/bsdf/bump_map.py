"""Bump map: normals from a texture of heights."""

import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import components, from_components, scale
from jaxdr.scene.bsdf.base import BSDF, TwoSided
from jaxdr.scene.bsdf.normal_map import TurnedNormal, one_sided
from jaxdr.scene.bsdf.parameters import number
from jaxdr.scene.textures import Heights, Texture


@checked
class BumpMap(TurnedNormal):
    """A BSDF whose normal is turned at every point, as if the surface had the `height` of a texture (`bumpmap`).

    `height` is a bilinear `Bitmap` of one channel. Its values times `scale` are heights in scene units, along the
    normal. Only the normal changes, not the surface. Normals that face away, shadowing and two-sided BSDFs are treated
    as in `NormalMap`. The jump that `NormalMap` tells of has no derivative here either.

    The slope is the difference of heights over one texel. So it is continuous, and has derivatives by the texture and
    by the surface. Mitsuba 3 takes the slope of the bilinear patch, which jumps at the centres of texels. So its bumps
    show facets when magnified. The slope here is the mean of that slope over one texel.

    Raises ValueError for a height that is no bilinear Bitmap of one channel.
    """

    height: Float[Array, "*n 2"] | Heights
    bsdf: BSDF
    scale: Float[Array, "*n"]

    def __init__(self, height: Texture, bsdf: BSDF | TwoSided, scale: ArrayLike = 1.0):
        self.height = Heights.of(height, "BumpMap: height")
        self.bsdf = one_sided(bsdf, "BumpMap", "height")
        self.scale = number(scale, "BumpMap: scale")

    def turned_normal(self):
        along, across = components(scale(self.height, -self.scale))
        return from_components(along, across, jnp.ones_like(along))
