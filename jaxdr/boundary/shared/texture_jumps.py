"""Where textures jump: at UV seams, which are creases, and inside faces, where no estimator looks for jumps."""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int

from jaxdr.boundary.shared.refusals import INTERIOR, Asked, Refusal
from jaxdr.geometry.vector import dot, interpolate, norm
from jaxdr.scene.color import magnitude
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene, textures_of, unwrap
from jaxdr.transport.emission import surface_radiance
from jaxdr.transport.interaction import material_point
from jaxdr.transport.texturing import tangents_along_u, texture_difference, texture_point

PROBES = 5  # points along an edge at which the two sides are compared
TURN = 1e-6  # 1 - cosine: if tangents along u differ by more, a normal map turns at the edge
STEP = 1e-4  # a larger difference of textures in the middle of an edge is not rounding
TOLERANCE = 1e-3  # relative: if lengths along u or v differ by more, a bump map jumps at the edge
LEAST = 0.1  # smallest jump at a seam: between the probes the textures may differ more


def seam_jumps(packed: PackedScene, edge: Int[Array, " C"]) -> Float[Array, " C"]:
    """How much the textures of the two faces at edges differ, roughly; zero where UVs continue across. Detached.

    It is positive wherever textures may jump inside a mesh. Its size changes the noise only.
    """
    if not packed.has_seams:
        return jnp.zeros(edge.shape, packed.vertices.dtype)
    packed = jax.tree.map(stop_gradient, packed)
    interior, points = _beside(packed, edge)
    apart = jnp.zeros_like(interior)
    for share in (0.0, 1.0) if packed.uvs is not None else ():
        one, two = (_uv(packed, point) for point in points(share))
        apart |= (one != two).any(-1)
    if packed.uses_faces:
        apart |= texture_difference(packed, *points(0.5)) > STEP
    if packed.uses_slopes:
        one, two = (texture_point(packed, point).axes for point in points(0.5))
        assert one is not None and two is not None  # `texture_point` has axes if slopes are used
        apart |= (jnp.abs(one - two) > TOLERANCE * (norm(one) + norm(two))[:, None]).any(-1)
    if packed.tangential:
        (one, _), (two, _) = (tangents_along_u(packed, point) for point in points(0.5))
        apart |= dot(one, two) < 1.0 - TURN
    jump = sum(texture_difference(packed, *points((i + 0.5) / PROBES)) for i in range(PROBES)) / PROBES
    return jnp.where(interior & apart, LEAST + jump, 0.0)


def glow_jumps(packed: PackedScene, edge: Int[Array, " C"]) -> Float[Array, " C"]:
    """How much the emission of the two faces at edges differs there, roughly: magnitude. Detached."""
    packed = jax.tree.map(stop_gradient, packed)
    interior, points = _beside(packed, edge)
    total = jnp.zeros(edge.shape, packed.vertices.dtype)
    for i in range(PROBES):
        one, two = (surface_radiance(packed, point) for point in points((i + 0.5) / PROBES))
        total = total + magnitude(one - two) / PROBES
    return jnp.where(interior, total, 0.0)


def _beside(packed: PackedScene, edge: Int[Array, " C"]):
    """(which edges have two faces, function of a fraction of the edges that yields the points on either face)."""
    interior, ends = packed.edges.interior[edge], packed.edges.vertices[edge]
    sides = []
    for k in (0, 1):
        face = jnp.where(interior, packed.edges.faces[edge, k], 0)
        sides.append((face, [packed.faces[face] == ends[:, i, None] for i in (0, 1)]))

    def points(share):
        for face, (start, end) in sides:
            yield material_point(packed, face, (1.0 - share) * start + share * end, interior)

    return interior, points


def _uv(packed, point):
    return interpolate(packed.uvs[packed.uv_faces[point.face]], point.barycentric)


def _moved_jumps(asked: Asked) -> str | None:
    """A message if a texture's jumps inside faces move in the image; None if not.

    With fixed rays, first hits slide over the shapes that move relative to the camera. Behind mirrors and smooth glass
    that move, later hits slide over any shape. Points in material form move with the jumps.
    """
    scene, moving, fixed_rays = asked.scene, asked.moving.seen, asked.primary == "fixed_ray"
    pairs = zip(scene.shapes.values(), moving, strict=True)
    delta = any(moves and unwrap(shape.bsdf).delta for shape, moves in pairs)
    in_mirrors = ["mirrors and smooth glass that stay"] if delta else []
    for (name, shape), moves in zip(scene.shapes.items(), moving, strict=True):
        remedies = (['primary="material"'] if fixed_rays and moves else []) + in_mirrors
        for field, texture in textures_of(shape):
            if remedies and not texture.continuous:
                return (
                    f"render: {name}.{field} jumps inside faces ({type(texture).__name__}), and jumps that move in "
                    f"the image have no derivative with fixed rays; use {' and '.join(remedies)}, a bilinear Bitmap, "
                    f"{INTERIOR}"
                )
    return None


def _moved_maps(active: Scene) -> str | None:
    """A message if a texture that jumps inside faces moves over its surface; None if not.

    The leaves of `active` are bools: whether they are differentiated.
    """
    for name, shape in active.shapes.items():
        for field, texture in ((field, part) for field, whole in textures_of(shape) for part in whole.parts):
            # All leaves but its data place a texture on the surface.
            moves = bool(shape.mesh.uvs) or sum(jax.tree.leaves(texture)) > sum(jax.tree.leaves(texture.data()))
            if texture.uses_uv and moves and not texture.continuous:
                return (
                    f"render: {name}.{field} jumps inside faces ({type(texture).__name__}): it has no derivative "
                    f"by to_uv or UVs; use a bilinear Bitmap, {INTERIOR}"
                )
    return None


MOVED_JUMPS = Refusal(
    "textures that jump inside faces (`Checkerboard`, nearest `Bitmap`) and move in the image",
    'a bilinear `Bitmap`, `primary="material"`',
    _moved_jumps,
)
MOVED_MAPS = Refusal("textures that jump inside faces, by `to_uv` or UVs", "a bilinear `Bitmap`", _moved_maps)
