"""Boundary points on the planes at the far ends of segments: their weights and their normal velocities."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.shared.blocks import sum_over_blocks
from jaxdr.boundary.shared.path_segments import PathSegments
from jaxdr.boundary.shared.projection import Projection, displacement
from jaxdr.geometry.vector import scale
from jaxdr.scene.packed import PackedScene


class OnPlanes(NamedTuple):
    """Projected edges in slots, with the segments that they bound and the far ends of these segments; detached.

    `weight` times velocity is the contribution; the weight is zero where nothing counts.
    """

    segment: Int[Array, " C"]
    edge: Int[Array, " C"]
    projection: Projection
    face: Int[Array, " C"]
    barycentric: Float[Array, "C 3"]
    infinite: Bool[Array, " C"]
    direction: Float[Array, "C 3"]
    weight: Float[Array, "C 3"]


def sum_on_planes(
    packed: PackedScene, paths: PathSegments, points: OnPlanes, used: Int[Array, ""]
) -> Float[Array, "N 3"]:
    """Weight x normal velocity, summed over the points of each of N paths: zero in value, right in derivative.

    The first `used` slots are filled.
    """

    def values(block, number):
        ends = paths.ends_to(block.segment, block.face, block.barycentric, block.infinite, block.direction)
        moved = displacement(packed, block.edge, ends, block.projection)
        moved = jnp.where(number < used, moved - stop_gradient(moved), 0.0)
        value = scale(block.weight, moved)
        return jnp.zeros((paths.paths, 3), value.dtype).at[paths.path(block.segment)].add(value)

    return sum_over_blocks(values, points, used)
