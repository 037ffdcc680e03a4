"""What is seen in narrow lobes whose sampled directions are held fixed (attached form, DESIGN 2b).

The image in such a lobe has the discontinuities of one that a camera takes: silhouettes and creases, with both sides.
With T the rotation by which directions turn with the lobe (`BSDF.turn`), e the direction of an edge seen from the
apex, n its normal, and F = f_s |cos| L on either side,

    d/dθ of the integral over directions  =  interior  +  integral of (F_1 - F_2) n · (∂e - ∂T(e)) dl.

Light of emitters counts by its MIS share w_b; what emitter samples account for has no ∂T: their far ends are material
points, which `EmitterLines` deals with, and for the environment fixed directions.
"""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.boundary.background import SeenEdges, background_point, seen_edges
from jaxdr.boundary.chords import LobeChords, balance, lobe_weight
from jaxdr.boundary.crossings import (
    BOUNDS,
    MOVES,
    Chosen,
    Crossings,
    Prepared,
    RankedEdges,
    apex_moves,
    draw_lobe_chords,
    find_crossings,
    sample_densities,
)
from jaxdr.boundary.folds import FLAT, SMOOTH, fold_tree
from jaxdr.boundary.silhouettes import BESIDE, PathSegments, horizon_normal
from jaxdr.boundary.texture_jumps import seam_jumps
from jaxdr.geometry.vector import dot, norm, normalize
from jaxdr.scene.color import luminance
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted
from jaxdr.transport.interaction import SurfacePoint, either, material_point
from jaxdr.transport.path import PathSettings
from jaxdr.transport.radiance import gathered_radiance
from jaxdr.transport.sampler import lattice

TOUCHING = 50.0  # how much further than from the edge in the image a ray beside it may end on an oblique surface


def folded_edges(packed: PackedScene, moving: Bool[Array, " S"], rays: str) -> RankedEdges:
    """Edges at which the image in a lobe may jump: all but in a plane, or at UV seams there. Detached."""
    edges = packed.edges
    normal = normalize(stop_gradient(packed.face_normals()))
    n0, n1 = normal[edges.faces[:, 0]], normal[edges.faces[:, 1]]
    flat = edges.interior & (norm(jnp.cross(n0, n1)) < FLAT) & (dot(n0, n1) > 0)
    if packed.uvs is not None:
        flat &= seam_jumps(packed, jnp.arange(flat.shape[0])) == 0
    rank = jnp.where(flat, 0, jnp.where(moving[edges.shape], MOVES, BOUNDS)).astype(packed.vertices.dtype)
    return RankedEdges(rank, fold_tree(packed, rank, rays))


class AttachedLines:
    """Geodesic chords around directions that are held fixed in their lobes, for the image that is seen there."""

    traces_paths = True

    def __init__(
        self,
        packed: PackedScene,
        prepared: Prepared,
        paths: PathSegments,
        settings: PathSettings,
        reach: float,
        typical: Float[Array, ""],
    ):
        self.packed, self.prepared, self.paths, self.settings, self.reach = packed, prepared, paths, settings, reach
        self.detached = jax.tree.map(stop_gradient, packed)
        self.typical = stop_gradient(jnp.where(typical > 0, typical, 1.0))

    def search(self, chosen: Chosen, key, room: int):
        """(chords, crossings, weight of the thinning, number of crossings)."""
        key_chord, key_seed = jax.random.split(key)
        lobes, apex = draw_lobe_chords(self, chosen, self.reach, key_chord)
        chords = lobes.chords(apex, 2.0 * stop_gradient(self.packed.size()), folds=True)
        # How what is behind an edge moves does not matter.
        needed = jnp.where(apex_moves(self, jnp.maximum(chosen.vertex, 0)), BOUNDS, MOVES)
        folds = self.prepared.folds
        assert folds is not None  # made wherever lobes may be narrow
        return lobes, *find_crossings(self, folds, chosen, needed, apex, chords, key_seed, room)

    def score(self, drawn: LobeChords, found: Crossings) -> Float[Array, " C"]:
        """Expected contribution of crossings per motion of the edge: luminance. Only the noise depends on it."""
        seen, weight = self._boundary(drawn, found)
        near, far, _ = self._faces(found, seen)
        share = self._shares(seen, jax.tree.map(lambda *x: jnp.stack(x), near, far))
        emission = jax.vmap(lambda point: emitted(self.detached, point, -seen.towards))
        glow = share * luminance(emission(jax.tree.map(lambda *x: jnp.stack(x), near, far)))
        glow = jnp.where(far.valid, jnp.abs(glow[0] - glow[1]), glow[0])
        n0, n1 = (jnp.where(dot(p.normal, seen.towards)[:, None] > 0, -p.normal, p.normal) for p in (near, far))
        smooth = jnp.asarray(self.packed.smooth)[self.packed.face_shape[near.face]]
        fold = norm(n0 - n1) * jnp.where(smooth, SMOOTH, 1.0)
        if self.packed.uvs is not None:
            fold = fold + seam_jumps(self.packed, found.edge)
        jump = self.typical * jnp.where(far.valid, fold, 1.0) + glow
        return luminance(weight) * jump / seen.distance

    def value(self, drawn: LobeChords, found: Crossings, number, weight, key) -> Float[Array, "C 3"]:
        """Contributions times `weight`: zero in value, right in derivative."""
        seen, value = self._boundary(drawn, found)
        near, far, at_crease = self._faces(found, seen)
        open_side, clear = background_point(self.detached, self._apex(found), seen, found.valid, self.settings)
        reached, shared = self._meets(found, seen, open_side, at_crease)
        clear = clear | reached
        value = value * jnp.where(shared, 0.5, 1.0)[:, None]
        valid = found.valid & clear
        open_side = either(at_crease, far, open_side)
        sides = jax.tree.map(lambda *x: jnp.stack(x), open_side, near)

        share = self._shares(seen, sides)[..., None]
        emission = jax.vmap(lambda point: emitted(self.detached, point, -seen.towards))(sides)
        scattered = self._scattered(seen, sides, valid, number, key)
        in_lobe = scattered + share * emission
        sky = ~sides.valid[..., None]
        seen_at_all = scattered + jnp.where(sky, 1.0, share) * emission

        # Directions of unused slots are not unit, and narrow lobes overflow there.
        def jump(light):
            return jnp.where(valid[:, None], value * weight[:, None] * (light[0] - light[1]), 0.0)

        edge, lobe = self._motion(found, seen)
        total = jump(seen_at_all) * edge[:, None] - jump(in_lobe) * lobe[:, None]
        if self.packed.environment_turns:
            sampled = jnp.where(sky, (1.0 - share) * emission, 0.0)
            turned = dot(seen.pole, self.packed.turned(seen.towards))
            total = total - jump(sampled) * (turned - stop_gradient(turned))[:, None]
        return total

    def _boundary(self, drawn: LobeChords, found: Crossings) -> tuple[SeenEdges, Float[Array, "C 3"]]:
        """(the crossed edges as seen, contributions without radiance and normal velocity)."""
        seen = seen_edges(self.packed, self.paths, found.vertex, found.edge, found.along, found.valid)
        scatterer = self.paths.scatterer(found.vertex)
        lobes = LobeChords(*(table[found.chord] for table in drawn))
        counts = found.valid & scatterer.above_horizon(stop_gradient(seen.edge_point))
        weight = jnp.where(counts, lobe_weight(scatterer, lobes, seen.towards, uniform=True), 0.0)
        weight = self.paths.table.throughput[found.vertex] * weight[:, None]
        return seen, weight * scatterer.eval(seen.towards)

    def _apex(self, found: Crossings) -> SurfacePoint:
        return jax.tree.map(stop_gradient, self.paths.apex(found.vertex))

    def _faces(self, found: Crossings, seen: SeenEdges) -> tuple[SurfacePoint, SurfacePoint, Bool[Array, " C"]]:
        """(the edge points on the visible face beyond the edge, on the one before it if any, whether there is one).

        Beyond is where the pole points to. Which face of several on one side is in front, their slopes tell: no ray has
        to hit faces that may be edge-on.
        """
        packed, edges = self.detached, self.packed.edges
        faces, opposite, ends = edges.faces[found.edge], edges.opposite[found.edge], edges.vertices[found.edge]
        exists = (faces >= 0) & (faces != seen.apex_face[:, None])
        height = dot(packed.vertices[opposite] - packed.vertices[ends[:, :1]], seen.pole[:, None])
        normal = packed.face_normals()[faces]
        view = dot(normal, seen.towards[:, None])
        slope = dot(normal, seen.pole[:, None]) / jnp.where(view == 0, 1.0, view)

        def in_front(side):
            there = exists & (side * height > 0)
            best = jnp.where(there, side * slope, -jnp.inf).argmax(-1)[:, None]
            face = jnp.where(there.any(-1), jnp.take_along_axis(faces, best, 1)[:, 0], 0)
            corners = packed.faces[face]
            start, end = (corners == ends[:, k, None] for k in (0, 1))
            along = found.along[:, None]
            return material_point(packed, face, start * (1 - along) + end * along, there.any(-1))

        far = in_front(-1.0)
        return in_front(1.0), far, far.valid

    def _meets(self, found: Crossings, seen: SeenEdges, hit: SurfacePoint, at_crease):
        """(whether rays beside edges reach them, whether they meet a border that another edge stands for as well).

        A surface that touches the edge hides nothing: a corner between shapes is a crease of the image. Where it ends
        there too, both edges are there, and each counts by half.
        """
        edge_point = stop_gradient(seen.edge_point)
        beside = BESIDE * jnp.maximum(jnp.abs(edge_point).max(-1), jnp.abs(seen.apex).max(-1))
        slack = TOUCHING * beside
        depth = dot(hit.position - seen.apex, seen.towards)
        neighbours = (self.packed.edges.faces[found.edge] == hit.face[:, None]).any(-1)
        reached = hit.valid & ((depth > seen.distance - slack) | (at_crease & neighbours))
        corners = self.detached.vertices[self.packed.faces[hit.face]]
        longest = norm(corners - jnp.roll(corners, 1, axis=1)).max(-1)
        on_border = hit.barycentric.min(-1) * 2.0 * hit.area < slack * longest
        shared = hit.valid & ~at_crease & (jnp.abs(depth - seen.distance) < slack) & on_border
        return reached, shared

    def _shares(self, seen: SeenEdges, sides: SurfacePoint) -> Float[Array, "2 C"]:
        """Share of the emitted light that the lobe's own samples account for, by the balance heuristic."""
        scatterer = self.paths.scatterer(seen.segment)

        def share(point):
            emitters, lobe = sample_densities(self.detached, scatterer, point, seen.towards)
            return balance(lobe, emitters)

        return jax.vmap(share)(sides)

    def _scattered(self, seen: SeenEdges, sides: SurfacePoint, valid, number, key) -> Float[Array, "2 C 3"]:
        """Radiance that both sides scatter towards the apex, by the same random numbers."""
        bounces = self.settings.max_depth - 2
        if bounces == 0:
            return jnp.zeros_like(sides.position)
        key_first, key_path = jax.random.split(key)
        u = lattice(key_first, 1, number, 4, seen.distance.dtype)[0]
        remaining = jnp.where(valid, bounces - seen.segment // self.paths.paths, 0)
        point = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), sides._replace(valid=sides.valid & valid))
        towards, u, remaining, stream = (
            jnp.concatenate([x, x]) for x in (seen.towards, u, remaining, jnp.arange(u.shape[0]))
        )
        key_path = jax.random.fold_in(key_path, number[0])
        settings = self.settings
        return gathered_radiance(
            self.detached, point, towards, u, key_path, settings, bounces, remaining, stream
        ).reshape(2, -1, 3)

    def _motion(self, found: Crossings, seen: SeenEdges) -> tuple[Float[Array, " C"], Float[Array, " C"]]:
        """(of the edge as seen from the apex, of that direction in the lobe): along the pole, zero in value."""
        pole = seen.pole
        # The apex stays in its face: where that sets, the edge moves as the plane does; see `project_edges`.
        horizon = -dot(horizon_normal(self.packed, seen.apex_face, pole), seen.towards)
        offset = seen.edge_point - self.paths.apex(found.vertex).position
        edge = jnp.where(seen.own, horizon, dot(pole, offset) / seen.distance)
        lobe = dot(pole, self.paths.moving_scatterer(found.vertex).turn(seen.towards))
        return edge - stop_gradient(edge), lobe - stop_gradient(lobe)
