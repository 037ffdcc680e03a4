"""How likely a path vertex enters a node of the tree: never where it has no silhouette that counts.

The rejection is that of Soroka et al. 2025 (`dual_bounds`). Their heuristics for the other nodes are not known here.
These are our own, after Li et al. 2018: length x exterior angle / distance^2 x BSDF x light.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxdr.boundary.baselines.quadric_sampling.dual_bounds import one_sided
from jaxdr.boundary.baselines.quadric_sampling.silhouette_tree import Nodes
from jaxdr.geometry.vector import dot, norm, normalize, scale, triangle_normals, z_of
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.color import magnitude
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.shading import Scatterer

DEFENCE = 0.05  # per solid angle: what every node has beside its BSDF value
NEAREST = 0.25  # a node's squared distance is at least this share of its squared radius
BLIND = 0.2  # share of the descents that look at nothing but weights: a large node's distance says little
BEYOND = 0.2  # what nodes before no emitter have where other light counts as well
BALLS = 16  # at most so many balls around the emitters


class Balls(NamedTuple):
    """Balls that contain all area emitters; detached.

    `normal`: where each ball contains one face, the unit normal of this face, and `corner` one of its corners: only
    what lies before the face hides its light. Else None.
    """

    centre: Float[Array, "B 3"]
    radius: Float[Array, " B"]
    normal: Float[Array, "B 3"] | None
    corner: Float[Array, "B 3"]


def emitter_balls(packed: PackedScene) -> Balls | None:
    """A ball around each emitting face, or around runs of faces if there are many; None without area emitters."""
    if not packed.has_area_emitters:
        return None
    count = packed.emitter_faces.shape[0]
    balls = min(BALLS, count)
    each = -(-count // balls)
    number = np.minimum(np.arange(balls * each), count - 1).reshape(balls, each)
    triangles = packed.corners_of(packed.emitter_faces[number])
    points = triangles.reshape(balls, -1, 3)
    centre = 0.5 * (points.min(1) + points.max(1))
    normal = normalize(triangle_normals(triangles[:, 0])) if each == 1 else None
    return Balls(centre, norm(points - centre[:, None]).max(1), normal, points[:, 0])


class Importance(NamedTuple):
    """The importance of nodes for n path vertices. Called with nodes [n, 2], the two children of each vertex's node.

    `other`: whether light counts that area emitters do not send there directly. Without it, nodes that hide no emitter
    are left out.
    """

    scatterer: Scatterer
    balls: Balls | None
    other: Bool[Array, " n"]

    def __call__(self, nodes: Nodes) -> Float[Array, "n 2"]:
        position = self.scatterer.point.position[:, None]
        offset = nodes.centre - position
        silent = one_sided(nodes.planes, scale(-offset, 1.0 / nodes.size), nodes.slack) & (nodes.open == 0)
        normal = scale(self.scatterer.normal, jnp.sign(z_of(self.scatterer.wi)))[:, None]
        below = dot(normal, offset) + dot(jnp.abs(normal), nodes.extent) <= 0
        counts = (nodes.weight > 0) & ~silent & ~below
        radius2 = dot(nodes.extent, nodes.extent)
        gap = jnp.maximum(jnp.abs(offset) - nodes.extent, 0.0)
        distance2 = dot(gap, gap) + NEAREST * radius2
        distance2 = jnp.where(distance2 > 0, distance2, 1.0)
        distance = norm(offset)
        towards = normalize(jnp.where((distance > 0)[..., None], offset, normal))
        # The sine of half the angle of the cone around the node's ball; a right angle and more inside of it.
        angle = jnp.where(
            distance2 > 0, jnp.arcsin(jnp.clip(jnp.sqrt(radius2) / jnp.maximum(distance, 1e-30), 0, 1)), 0
        )
        angle = jnp.where(distance * distance > radius2, angle, jnp.pi)
        light = self._light(nodes, position, towards, angle)
        weight = jnp.where(counts & (light > 0), nodes.weight, 0.0)
        value = weight / distance2 * (DEFENCE + self._bsdf(towards, angle)) * light
        return (1.0 - BLIND) * _shares(value) + BLIND * _shares(weight)

    def _bsdf(self, towards, angle):
        """The BSDF in the direction of the cone's that is nearest to the mirrored one."""
        x, y, z = jnp.split(self.scatterer.wi, 3, axis=-1)
        mirrored = self.scatterer.frame.to_world(jnp.concatenate([-x, -y, z], -1))[:, None]
        cosine = jnp.clip(dot(towards, mirrored), -1.0, 1.0)
        turn = jnp.minimum(angle, jnp.arccos(cosine))
        across = mirrored - scale(towards, cosine)
        length = norm(across)
        across = scale(across, 1.0 / jnp.where(length > 0, length, 1.0))
        nearest = scale(towards, jnp.cos(turn)) + scale(across, jnp.sin(turn))
        values = [magnitude(self.scatterer.eval(normalize(nearest[:, k]))) for k in range(2)]
        return jnp.stack(values, -1)

    def _light(self, nodes, position, towards, angle):
        """1 where the cone may meet an emitter; else `BEYOND`, or 0 where no other light counts."""
        other = jnp.where(self.other, BEYOND, 0.0)[:, None].astype(towards.dtype)
        if self.balls is None:
            return jnp.ones_like(angle)
        meets = jnp.zeros(angle.shape, bool)
        for k in range(self.balls.radius.shape[0]):
            offset = self.balls.centre[k] - position
            distance, radius = norm(offset), self.balls.radius[k]
            outside = distance > radius
            ratio = jnp.clip(radius / jnp.where(outside, distance, radius), 0.0, 1.0)
            between = jnp.arccos(jnp.clip(dot(towards, scale(offset, 1.0 / jnp.maximum(distance, 1e-30))), -1.0, 1.0))
            # A little wider than computed: near one the inverse cosine rounds by the root of the unit.
            here = ~outside | (between <= angle + jnp.arcsin(ratio) + 1e-3)
            if self.balls.normal is not None:
                # The outline of the emitter lies in its plane, but for rounding.
                normal, corner = self.balls.normal[k], self.balls.corner[k]
                rounding = 16 * jnp.finfo(normal.dtype).eps * jnp.abs(corner).max()
                height = dot(normal, nodes.centre - corner) + dot(jnp.abs(normal), nodes.extent)
                here = here & (height > rounding)
            meets = meets | here
        return jnp.where(meets, 1.0, other)


def _shares(value: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    """Shares of both children; zeros if both are zero."""
    total = value.sum(-1, keepdims=True)
    return safe_divide(value, total, total > 0, 0.0)
