"""Planar emitters: which emitting faces lie in one plane, and which part of a line in this plane is inside them."""

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.shared.projection import affine_coordinates, affine_rates
from jaxdr.geometry.vector import corners, dot, norm, normalize, triangle_normals
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.emitter_clusters import FEW_FACES
from jaxdr.scene.packed import PackedScene


def few_emitter_faces(packed: PackedScene) -> bool:
    """Whether emitters have so few faces that they are treated as whole polygons, not face by face."""
    return packed.has_area_emitters and packed.emitter_faces.shape[0] <= FEW_FACES


def emitter_groups(packed: PackedScene) -> Int[Array, " F"]:
    """A number for every emitting face, the same for faces of one shape in one plane; -1 for the others."""
    count = packed.emitter_faces.shape[0]
    group = jnp.arange(count)
    if few_emitter_faces(packed):
        triangles = stop_gradient(packed.vertices)[packed.faces[packed.emitter_faces]]
        first, second, _ = corners(triangles)
        normal = normalize(triangle_normals(triangles))
        offset = triangles[None] - first[:, None, None]  # [L, L, 3, 3]
        height = jnp.abs(dot(offset, normal[:, None, None])).max(-1)
        flat = (height <= 1e-4 * norm(second - first)[:, None]) & (dot(normal[:, None], normal[None]) > 0)
        shape = packed.face_shape[packed.emitter_faces]
        same = flat & flat.T & (shape[:, None] == shape[None])
        group = jnp.where(same, group[None], count).min(1)
    return jnp.full(packed.faces.shape[0], -1, jnp.int32).at[packed.emitter_faces].set(group.astype(jnp.int32))


def part_inside(
    barycentric: Float[Array, "*n 3"], rate: Float[Array, "*n 3"], low: Float[Array, "*#n"], high: Float[Array, "*#n"]
) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    """(start, end): the part of a line's parameter range [low, high] that is inside triangles; start = end if none.

    `barycentric` are coordinates of the line's origin, `rate` their derivatives along the line.
    """
    root = safe_divide(-barycentric, rate)
    missed = ((rate == 0) & (barycentric < 0)).any(-1)
    start = jnp.maximum(low, jnp.where(rate > 0, root, -jnp.inf).max(-1))
    end = jnp.minimum(high, jnp.where(rate < 0, root, jnp.inf).min(-1))
    missed = missed | (end <= start)
    return jnp.where(missed, 0.0, start), jnp.where(missed, 0.0, end)


def chord_inside(
    packed: PackedScene,
    group: Int[Array, " F"],
    face: Int[Array, " N"],
    point: Float[Array, "N 3"],
    direction: Float[Array, "N 3"],
    low: Float[Array, " N"] | None = None,
    high: Float[Array, " N"] | None = None,
) -> tuple[Float[Array, " N"], Float[Array, " N"], Float[Array, " N"]]:
    """(first, last, length) of lines through points of emitting faces, inside the emitter's faces in that plane.

    `first` < 0 < `last` are distances along unit `direction`; `length` is the part between them that is inside the
    faces. If `low` and `high` are given, the line is cut to this range. Detached.
    """
    vertices = stop_gradient(packed.vertices)
    if few_emitter_faces(packed):
        triangles, same = packed.emitter_faces, group[packed.emitter_faces] == group[face][:, None]
    else:
        triangles, same = face[:, None], jnp.ones((face.shape[0], 1), bool)
    polygon = vertices[packed.faces[triangles]]  # [L, 3, 3] or [N, 1, 3, 3]
    barycentric, rate = affine_coordinates(polygon, point[:, None]), affine_rates(polygon, direction[:, None])
    infinity = jnp.asarray(jnp.inf, rate.dtype)
    lowest, highest = (-infinity, infinity) if low is None or high is None else (low[:, None], high[:, None])
    start, end = part_inside(barycentric, rate, lowest, highest)
    start, end = jnp.where(same, start, 0.0), jnp.where(same, end, 0.0)
    return start.min(-1), end.max(-1), (end - start).sum(-1)


def emitter_face_at(
    packed: PackedScene, group: Int[Array, " F"], face: Int[Array, " N"], point: Float[Array, "N 3"]
) -> tuple[Int[Array, " N"], Float[Array, "N 3"], Bool[Array, " N"]]:
    """(face, barycentric coordinates, inside or not) of points in the planes of emitting faces `face`.

    If emitters are treated as polygons, the other faces in the plane count as well.
    """
    vertices = stop_gradient(packed.vertices)
    faces = face[:, None]
    if few_emitter_faces(packed):
        faces = jnp.broadcast_to(packed.emitter_faces[None], (face.shape[0], packed.emitter_faces.shape[0]))
    barycentric = affine_coordinates(vertices[packed.faces[faces]], point[:, None])
    depth = jnp.where(group[faces] == group[face][:, None], barycentric.min(-1), -jnp.inf)
    best = depth.argmax(-1)[:, None]
    chosen = jnp.take_along_axis(faces, best, 1)[:, 0]
    inside = jnp.take_along_axis(depth, best, 1)[:, 0] > -1e-4
    return chosen, jnp.take_along_axis(barycentric, best[..., None], 1)[:, 0], inside
