"""Clusters of emitting faces: how much each matters at a point, by its power, its distance and where it faces.

Only emitters of many faces have clusters. Faces that lie close together (in Morton order) share a leaf of a complete
binary tree of few levels. A node bounds its faces by a sphere and their normals by a cone. Its importance at a point is
an upper bound of the light that it sends there: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with
Adaptive Tree Splitting", Eq. 3. The importance of all nodes is computed at once. They are few, and that is faster than
a descent through the tree. Everything here is detached. The densities are exact, whatever the importance is.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.vector import components, corners, cross, dot, norm, normalize
from jaxdr.scene.sampling import search_sorted_rows

# Up to this number of emitting faces in the scene there are no clusters: faces are chosen by power alone.
FEW_FACES = 16
FACES_OF_LEAF, MOST_LEAVES = 4, 32  # faces of a leaf, about, at least; leaves of a tree, at most
SMALL = 0.5  # a cluster is not split where the sine of the angle that its radius subtends is at most this
SLACK = 1e-3  # bounds are widened by this, against rounding


class EmitterClusters(eqx.Module):
    """A complete binary tree over the emitting faces of a scene. Its U = 2 K - 1 nodes are in heap order, leaves last.

    - `face`: the m faces of every leaf; `cdf`: their cumulative probabilities within the leaf.
    - `leaf`: the leaf of every face of the scene, 0 for faces that do not glow; `density`: the probability per area
      of points on a face, within its leaf, 0 for faces that do not glow.
    - `power`: the share of each node in all power; `radiance`: its power per area.
    - `centre`, `radius`: a sphere around the faces of each node.
    - `axis`, `cosine` (of the half-angle): a cone around the normals of each node.
    """

    face: Int[Array, "K m"]
    cdf: Float[Array, "K m"]
    leaf: Int[Array, " F"]
    density: Float[Array, " F"]
    power: Float[Array, " U"]
    radiance: Float[Array, " U"]
    centre: Float[Array, "U 3"]
    radius: Float[Array, " U"]
    axis: Float[Array, "U 3"]
    cosine: Float[Array, " U"]

    @property
    def leaves(self) -> int:
        """Number of leaves, K."""
        return self.face.shape[0]

    def sample(self, apex: Float[Array, "N 3"], u: Float[Array, " N"]) -> tuple[Int[Array, " N"], Float[Array, " N"]]:
        """(faces, uniform numbers that are left). Leaves are chosen by importance at the points, faces by power."""
        leaf, left = chosen(self._of_leaves(apex), u)
        place, left = search_sorted_rows(self.cdf, leaf, left)
        return self.face[leaf, place], left

    def pdf(self, apex: Float[Array, "N 3"], face: Int[Array, " N"]) -> Float[Array, " N"]:
        """Probability per area of `sample` at points on these faces; zero on faces that do not glow."""
        return picked(self._of_leaves(apex), self.leaf[face]) * self.density[face]

    def _of_leaves(self, apex: Float[Array, "N 3"]) -> Float[Array, "N K"]:
        """Probability of every leaf, as seen from the points."""
        return self._probabilities(self._importance(apex, self.leaves - 1), self.leaves - 1)

    def cut(self, apex: Float[Array, "N 3"]) -> "Cut":
        """For every point the largest clusters that look `SMALL` from there, chosen by importance.

        Every emitting face is in exactly one of them. Leaves are used even where they do not look small.
        """
        wide = self.radius > SMALL * norm(self.centre - apex[:, None])
        levels, first = [], 0
        free = jnp.ones((apex.shape[0], 1), bool)  # whether no cluster further up is small
        while first < wide.shape[1]:
            size = first + 1
            split = wide[:, first : first + size] & free
            last = first + size == wide.shape[1]
            levels.append(free if last else free & ~split)
            free = jnp.repeat(split, 2, axis=1)
            first += size
        used = jnp.concatenate(levels, 1)
        importance = jnp.where(used, self._importance(apex, 0), 0.0)
        return Cut(used, self._probabilities(importance, 0, used))

    def node_at(self, cut: "Cut", face: Int[Array, " N"]) -> Int[Array, " N"]:
        """The node of each point's cut that holds the point's glowing face."""
        node = self.leaf[face] + self.leaves - 1
        found = node
        for _ in range(self.leaves.bit_length() - 1):
            node = (node - 1) // 2
            found = jnp.where(picked(cut.used, node), node, found)
        return found

    def _importance(self, apex: Float[Array, "N 3"], first: int) -> Float[Array, "N k"]:
        """Upper bound of power x cosine / distance^2 at the points, for the nodes from `first` on."""
        power, centre, radius, axis, cosine = (
            table[first:] for table in (self.power, self.centre, self.radius, self.axis, self.cosine)
        )
        x, y, z = (a[:, None] - c for a, c in zip(components(apex), components(centre), strict=True))
        distance2 = x * x + y * y + z * z
        inside = distance2 <= radius**2
        distance = jnp.sqrt(jnp.where(inside, 1.0, distance2))
        nx, ny, nz = components(axis)
        off = jnp.clip((nx * x + ny * y + nz * z) / distance, -1.0, 1.0)  # cosines and sines; no angles: those are slow
        # Below 1 but for rounding: a GPU divides with an error of two units in the last place.
        wide_sine = jnp.where(inside, 0.0, jnp.minimum(radius / distance, 1.0))
        wide = jnp.sqrt(1.0 - wide_sine**2)
        off, off_sine = _less(off, jnp.sqrt(1.0 - off**2), wide, wide_sine)
        facing, _ = _less(off, off_sine, cosine, jnp.sqrt(1.0 - cosine**2))
        facing = jnp.where(inside, 1.0, jnp.maximum(facing, 0.0))
        return power * facing / jnp.maximum(distance2, radius**2)

    def _probabilities(self, importance, first: int, used: Any = True) -> Float[Array, "N k"]:
        """Probabilities of nodes in proportion to their importance; to their power where no node has any."""
        total = importance.sum(1, keepdims=True)
        either = jnp.where(total > 0, importance, jnp.where(used, self.power[first:], 0.0))
        return either / either.sum(1, keepdims=True)


class Cut(eqx.Module):
    """The nodes that are `used` at each point, and the `probability` of each node there."""

    used: Bool[Array, "N U"]
    probability: Float[Array, "N U"]


def chosen(probability: Float[Array, "N k"], u: Float[Array, " N"]) -> tuple[Int[Array, " N"], Float[Array, " N"]]:
    """(entry of every row, chosen by the row's probabilities; uniform numbers that are left)."""
    cumulative = jnp.cumsum(probability, 1)
    aim = u * cumulative[:, -1]
    entry = jnp.minimum((cumulative <= aim[:, None]).sum(1), probability.shape[1] - 1)
    width = picked(probability, entry)
    left = (aim - picked(cumulative, entry) + width) / jnp.where(width > 0, width, 1.0)
    return entry, jnp.clip(left, 0.0, 1.0)


def picked(table: Array, entry: Int[Array, " N"]) -> Array:
    """One entry of every row."""
    return jnp.take_along_axis(table, entry[:, None], 1)[:, 0]


def _less(cosine, sine, other, other_sine):
    """(cosine, sine) of the first angle minus the other one, or of zero if the other is larger."""
    less = cosine > other
    return jnp.where(less, 1.0, cosine * other + sine * other_sine), jnp.where(
        less, 0.0, sine * other - cosine * other_sine
    )


def leaf_count(faces: int) -> int:
    """Number of leaves of a tree over this number of emitting faces."""
    return min(MOST_LEAVES, 1 << max(0, math.ceil(math.log2(faces / FACES_OF_LEAF))))


def emitter_clusters(
    triangles: Float[Array, "L 3 3"], faces: Int[Array, " L"], weight: Float[Array, " L"], face_count: int
) -> EmitterClusters:
    """The tree over emitting `faces`, detached.

    `triangles` are their corners. Faces are chosen in proportion to `weight`. `face_count` is that of the whole scene.
    """
    triangles, weight = jax.lax.stop_gradient((triangles, weight))
    count, leaves = faces.shape[0], leaf_count(faces.shape[0])
    size = -(-count // leaves)
    slots = leaves * size
    repeated = jnp.arange(slots) >= count  # the last slots hold the last face once more, without power
    slot = jnp.argsort(_morton(triangles.mean(1)))[jnp.minimum(jnp.arange(slots), count - 1)]
    face, corner = faces[slot], triangles[slot]
    a, b, c = corners(corner)
    normal2 = cross(b - a, c - a)
    area = jnp.where(repeated, 0.0, 0.5 * norm(normal2))
    power = jnp.where(repeated, 0.0, weight[slot])
    nodes = []
    for level in range(leaves.bit_length()):
        nodes.append(_bounds(corner, normalize(normal2), power, area, 1 << level))
    share, radiance, centre, radius, axis, cosine = (jnp.concatenate(parts) for parts in zip(*nodes, strict=True))

    in_leaf = power.reshape(leaves, size)
    dark = in_leaf.sum(1, keepdims=True) == 0  # such a leaf is never chosen, but must not divide by zero
    within = jnp.where(dark, 1.0, in_leaf)
    within = within / within.sum(1, keepdims=True)
    density = jnp.where(dark, 0.0, within).reshape(-1) / jnp.where(area > 0, area, 1.0)
    cdf = jnp.cumsum(within, 1)
    return EmitterClusters(
        face=face.reshape(leaves, size),
        cdf=cdf / cdf[:, -1:],
        leaf=jnp.zeros(face_count, jnp.int32).at[face].add(jnp.where(repeated, 0, jnp.arange(slots) // size)),
        density=jnp.zeros(face_count, density.dtype).at[face].add(density),
        power=share / share[0],
        radiance=radiance,
        centre=centre,
        radius=radius,
        axis=axis,
        cosine=cosine,
    )


def _bounds(corner, normal, power, area, nodes: int):
    """(power, mean radiance, centre, radius, axis, cosine) of the nodes of one level, which has `nodes` of them."""
    power, area = (table.reshape(nodes, -1).sum(1) for table in (power, area))
    points = corner.reshape(nodes, -1, 3)
    centre = 0.5 * (points.min(1) + points.max(1))
    radius = norm(points - centre[:, None]).max(1) * (1.0 + SLACK)
    normals = normal.reshape(nodes, -1, 3)
    axis = normalize(normals.sum(1))
    cosine = dot(normals, axis[:, None]).min(1)
    angle = jnp.where(dot(axis, axis) > 0.5, jnp.arccos(jnp.clip(cosine, -1.0, 1.0)) + SLACK, math.pi)
    cosine = jnp.cos(jnp.minimum(angle, math.pi))
    return power, power / jnp.where(area > 0, area, 1.0), centre, radius, axis, cosine


def _morton(points: Float[Array, "L 3"]) -> Int[Array, " L"]:
    """Positions of points on a Morton curve through their bounding cube, with ten bits for each axis."""
    low = points.min(0)
    size = (points.max(0) - low).max()
    cell = jnp.clip((points - low) / jnp.where(size > 0, size, 1.0) * 1023.0, 0.0, 1023.0).astype(jnp.int32)
    code = jnp.zeros(points.shape[0], jnp.int32)
    for axis, along in enumerate(components(cell)):
        for bit in range(10):
            code = code | (((along >> bit) & 1) << (3 * bit + axis))
    return code
