"""Segments along which the camera's clipping planes cut faces.

The image jumps there: on one side the face is seen, on the other what lies behind it. The planes go with the camera.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.geometry.vector import between, components, corners, z_of
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.camera.base import FAR_CLIP, NEAR_CLIP, Camera
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.sampler import uniform


class CutSegments(NamedTuple):
    """Segments of a plane in the world, the face that each is on (-1: none), and what each counts."""

    ends: Float[Array, "n 2 3"]
    face: Int[Array, " n"]
    weight: Float[Array, " n"]


def cutting_planes(camera: Camera) -> tuple[float, ...]:
    """Depths of the clipping planes that are expected to cut something: those that were chosen. Static."""
    chosen = ((camera.near_clip, NEAR_CLIP), (camera.far_clip, FAR_CLIP))
    return tuple(plane for plane, default in chosen if plane != default)


def cut_segments(
    packed: PackedScene, moves: Bool[Array, " F"], plane: float, room: int, key: PRNGKeyArray
) -> CutSegments:
    """Where a plane at this depth cuts faces that `moves` marks. If there is no `room` for all, `key` chooses some."""
    depth = z_of(packed.camera.view().local(packed.vertices)) - plane
    beyond = depth[packed.faces] > 0
    cut = moves & (beyond.any(1) != beyond.all(1))
    rank = jnp.cumsum(cut)
    count = rank[-1]
    spacing = jnp.maximum(count / room, 1.0).astype(packed.vertices.dtype)
    offset = jnp.where(count > room, uniform(key, (), spacing.dtype), 0.0)
    wanted = jnp.floor((jnp.arange(room) + offset) * spacing).astype(rank.dtype)
    face = jnp.minimum(jnp.searchsorted(rank, wanted, side="right"), rank.shape[0] - 1)
    used = wanted < count

    # The corner that is alone on its side of the plane, and then the other two.
    first, second, third = components(beyond[face])
    alone = jnp.where(second == third, 0, jnp.where(first == third, 1, 2))
    number = (alone[:, None] + jnp.arange(3)) % 3
    vertices = jnp.take_along_axis(packed.faces[face], number, 1)
    (apex, *others), (height, *heights) = corners(packed.vertices[vertices]), components(depth[vertices])
    ends = [
        between(apex, other, safe_divide(height, height - h, used, 0.0))
        for other, h in zip(others, heights, strict=True)
    ]
    return CutSegments(jnp.stack(ends, 1), jnp.where(used, face, -1), jnp.where(used, spacing, 0.0))
