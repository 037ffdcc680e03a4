"""Neighbours of faces: which face lies behind each side of a face."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxdr.geometry.vector import normalize
from jaxdr.scene.packed import PackedScene


class Faces(NamedTuple):
    """Unit normals of all faces (detached) and the faces behind their sides.

    Side k lies opposite corner k. `behind` is -1 if no other face lies there, or more than one.
    """

    normal: Float[Array, "F 3"]
    behind: Int[Array, "F 3"]


def connect_faces(packed: PackedScene) -> Faces:
    """Neighbours of all faces, from the edges."""
    behind = jnp.full(packed.faces.shape, -1, jnp.int32)
    faces, opposite, interior = packed.edges.faces, packed.edges.opposite, packed.edges.interior
    for k in (0, 1):
        face = jnp.where(interior, faces[:, k], packed.faces.shape[0])
        corners = packed.faces[jnp.maximum(faces[:, k], 0)]
        side = jnp.argmax(corners == opposite[:, k, None], axis=1)
        behind = behind.at[face, side].set(faces[:, 1 - k], mode="drop")
    return Faces(jax.lax.stop_gradient(normalize(packed.face_normals())), behind)
