"""Removes the velocity across outlines of the surface at a segment's far end (Xu et al. 2023, after Eq. 10)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.boundary.shared.face_neighbours import Faces
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.shared.projection import affine_coordinates
from jaxdr.geometry.vector import (
    components,
    corners,
    cross,
    norm,
    orthonormal_basis,
    scale,
    triangle_normals,
)
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene

STRIP = 0.0625  # width of the strip along an outline, in widths of the kernel


class Inside(NamedTuple):
    """A matrix `along`, for which `along` v has no flux through outlines, and its divergence `spread`.

    div (`along` v) = tr(`along` grad v) + `spread` . v.
    """

    along: Float[Array, "N 3 3"]
    spread: Float[Array, "N 3"]


def keep_inside(packed: PackedScene, faces: Faces, ends: SegmentEnds, width: Float[Array, " N"]) -> Inside:
    """Matrices that remove the velocity across open edges and creases, at the targets of N segments.

    The component across falls linearly to zero in a strip along the edge, `STRIP` times `width` (of the kernel) wide.
    f ends or jumps at the edge, so a flux through it would be missing. Weights of auxiliary points could prevent the
    flux as well, but only over a whole kernel width. There the boundaries of what is seen would lose their velocity,
    too. The strip of a crease is in proportion to the jump of the normal. So a mesh that approximates a smooth surface
    has practically no strips.
    """
    behind = faces.behind[ends.face]
    unit = faces.normal[ends.face]
    jump = norm(faces.normal[jnp.maximum(behind, 0)] - unit[:, None])
    jump = jnp.where(behind >= 0, jump, 1.0)
    strip = STRIP * width[:, None] * jnp.maximum(jump, 1e-6)
    # Side k lies opposite corner k.
    start, end = jnp.roll(ends.corners, -1, axis=1), jnp.roll(ends.corners, -2, axis=1)
    lengths = norm(end - start)
    inverse = safe_divide(1.0, lengths)
    across = corners(cross(scale(end - start, inverse), unit[:, None]))
    area = norm(triangle_normals(ends.corners))
    height = area[:, None] * inverse
    on_surface = ~ends.infinite & (area > 0)
    triangles = jnp.where(on_surface[:, None, None], ends.corners, jnp.eye(3, dtype=strip.dtype))

    def along(point):
        distance = affine_coordinates(triangles, point) * height
        share = 1.0 - jnp.clip(distance / strip, 0.0, 1.0)
        share = jnp.where(on_surface[:, None], share, 0.0)
        result = jnp.broadcast_to(jnp.eye(3, dtype=strip.dtype), (point.shape[0], 3, 3))
        for normal, part in zip(across, components(share), strict=True):
            crossing = jnp.einsum("nj,njk->nk", normal, result)
            result = result - scale(normal, part)[:, :, None] * crossing[:, None]
        return result

    spread = jnp.zeros_like(ends.target)
    for tangent in orthonormal_basis(ends.normal):
        value, change = jax.jvp(along, (ends.target,), (tangent,))
        spread += jnp.einsum("nj,njk->nk", tangent, change)
    return Inside(value, spread)
