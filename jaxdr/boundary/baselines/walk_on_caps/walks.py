"""Velocities of directions by walks over spherical caps, of a fixed number of steps, to the closest silhouettes.

For a fixed apex let theta(w) be the angle from a direction w to the closest silhouette, hidden or not, and
r = share x theta. The field of k steps is the mean of that of k - 1 steps over the cap of radius r around w, u_k(w) =
mean of u_(k-1). u_0 is the velocity of the point that is closest. Where w approaches a silhouette, the cap shrinks to
its point, so that u_k has its velocity there. Elsewhere u_k is continuous for k > 0, though u_0 jumps where two
silhouettes are equally close: caps change continuously with w. So the divergence theorem holds for it, and u_k need
not be harmonic.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr import loops
from jaxdr.boundary.baselines.walk_on_caps.caps import in_cap, rim_over_area, tangents, turned
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.warped_area.divergence import Hidden, Velocities
from jaxdr.geometry import queries
from jaxdr.geometry.vector import between, corners, dot, norm, normalize, scale
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.transport.sampler import uniform


class Walks(NamedTuple):
    """How many `walks` of so many `steps` start on the rim of a cap, and in it; static.

    `share`: the radius of a cap over the angle to the closest silhouette. `reach`: angles count up to so many radians,
    and what has no silhouette in reach has no velocity. `rays`: as in `PathTracer`.
    """

    steps: int
    walks: int
    share: float
    reach: float
    rays: str = "auto"


class Closest(NamedTuple):
    """The silhouettes closest to directions: edges (-1: none in reach), the fractions along, and the angles.

    `away` is the gradient of the angle: the unit tangent that leads away from the silhouette, zero if there is none.
    """

    edge: Int[Array, "N Q"]
    along: Float[Array, "N Q"]
    angle: Float[Array, "N Q"]
    away: Float[Array, "N Q 3"]


class Views(NamedTuple):
    """What walkers see from N apexes: silhouettes of the `edges`, above the plane of the apex's face if they may count.

    `upwards` is that plane's normal, on the side of the light. F is zero at the horizon, so silhouettes below it, and
    those of the apex's own face, bound nothing. Rows without `lit` see nothing.
    """

    packed: PackedScene
    edges: queries.EdgeSet
    apex: Float[Array, "N 3"]
    upwards: Float[Array, "N 3"]
    lit: Bool[Array, " N"]
    walks: Walks

    def closest(self, direction: Float[Array, "N Q 3"]) -> Closest:
        """The silhouettes that are closest to directions."""
        shape = direction.shape[:2]
        apex, upwards = (jnp.broadcast_to(a[:, None], direction.shape) for a in (self.apex, self.upwards))
        reach = jnp.broadcast_to(jnp.where(self.lit, self.walks.reach, 0.0)[:, None], shape)
        cones = queries.ConeQuery(*(a.reshape(-1, *a.shape[2:]) for a in (apex, direction, upwards, reach)))
        found = queries.closest_silhouettes(self.packed.geometry, self.edges, cones, self.walks.rays)
        edge, along = found.edge.reshape(shape), found.along.reshape(shape)
        there = edge >= 0
        ends = self.packed.vertices[self.edges.ends[jnp.maximum(edge, 0)]]
        apart = normalize(between(*corners(ends), along) - apex) - direction
        angle = 2.0 * jnp.arcsin(jnp.minimum(1.0, 0.5 * norm(apart)))
        away = normalize(scale(direction, dot(apart, direction)) - apart)
        return Closest(
            edge,
            along,
            jnp.where(there, jnp.minimum(angle, self.walks.reach), self.walks.reach),
            jnp.where(there[..., None], away, 0.0),
        )


def walked_velocities(views: Views, direction: Float[Array, "N 3"], ends: SegmentEnds, key: PRNGKeyArray) -> Velocities:
    """u_k and its divergence at N unit directions, as sums over the ends of walks; all arguments detached.

    With Q walks of both kinds there are 1 + 2 Q slots a row: the silhouette closest to the direction itself, then the
    ends of walks from the rim, then of those from within the cap. The first has no part in u_k. It takes part in the
    divergence as a control variate: near a silhouette all walks end near its point, and their differences to it stay in
    proportion to the cap's radius, by which they are divided.
    """
    walks, count = views.walks, views.walks.walks
    n, dtype = direction.shape[0], direction.dtype
    centre = direction[:, None]
    here = views.closest(centre)
    radius = walks.share * here.angle
    grow = walks.share * here.away  # the radius' gradient
    key_start, key_walk = jax.random.split(key)
    u = uniform(key_start, (3, n, count), dtype)
    # Stratified around the rim and around the cap, each by one number a row. Two points of a rim lie opposite.
    places = jnp.arange(count, dtype=dtype) / count
    towards = tangents(jnp.broadcast_to(centre, (n, count, 3)), places + u[0, :, :1])
    rim = turned(centre, towards, radius)
    inside = in_cap(jnp.broadcast_to(centre, rim.shape), radius, places + u[1, :, :1], u[2])

    def step(place, key):
        found = views.closest(place)
        turn, area = uniform(key, (2, n, 2 * count), dtype)
        return in_cap(place, walks.share * found.angle, turn, area), None

    place = jnp.concatenate([rim, inside], 1)
    if walks.steps > 1:
        place = loops.scan(step, place, jax.random.split(key_walk, walks.steps - 1))[0]
    last = views.closest(place)

    factor = rim_over_area(radius) / count
    on_rim = scale(towards + grow, factor)
    # The divergence on a sphere leaves out what is normal to it.
    within = jnp.broadcast_to(-scale(grow, factor) - (2.0 / count) * centre, towards.shape)
    rate = jnp.concatenate([-scale(towards, factor).sum(1, keepdims=True), on_rim, within], 1)
    share = jnp.broadcast_to(jnp.where(jnp.arange(1 + 2 * count) > count, 1.0 / count, 0.0), rate.shape[:2])
    edge, along = (jnp.concatenate(a, 1) for a in ((here.edge, last.edge), (here.along, last.along)))
    return _in_slots(views, ends, edge, along, share.astype(dtype), rate)


def _in_slots(views: Views, ends: SegmentEnds, edge, along, share, rate) -> Velocities:
    """Points on edges as slots: material points of one of the edge's faces, which hide the target's direction."""
    there = ((edge >= 0) & views.lit[:, None]).reshape(-1)
    edge, along = jnp.maximum(edge, 0), along[..., None]
    face = views.edges.faces[edge][..., 0]
    corner, (start, end) = views.packed.faces[face], corners(views.edges.ends[edge][..., None])
    on_face = jnp.where(corner == start, 1.0 - along, jnp.where(corner == end, along, 0.0))
    full = edge.shape
    position = jnp.broadcast_to(ends.target[:, None], (*full, 3))
    third = jnp.full_like(position, 1 / 3)
    table = Hidden(position, jnp.zeros_like(face), third, face, on_face)
    table = jax.tree.map(lambda t: t.reshape(*full, 1, *t.shape[2:]), table)
    share = jnp.where(there, share.reshape(-1), 0.0)
    rate = jnp.where(there[:, None], rate.reshape(-1, 3), 0.0)
    return stop_gradient(Velocities(rows_where(there), there.sum(), share, rate, None, table))


def upwards(apex: SurfacePoint, direction: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    """Normals of the apexes' faces, on the side of the directions."""
    return scale(apex.normal, jnp.where(dot(apex.normal, direction) < 0, -1.0, 1.0).astype(direction.dtype))
