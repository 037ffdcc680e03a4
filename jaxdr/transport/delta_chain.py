"""Chains of delta lobes: the rays from the camera to the first surface that spreads light.

Mirrors and smooth glass continue a ray in a way that the film point and the random numbers for lobes determine. So
every segment of the chain is a differentiable function of the film point and of the scene.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr import loops
from jaxdr.geometry.vector import dot
from jaxdr.scene.camera import View
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import intersect, on_fixed_ray
from jaxdr.transport.shading import Scatterer


class ChainSegments(NamedTuple):
    """B segments of N chains, the camera's first; only `reached` segments exist.

    A segment goes from `origin` along the unit `direction`, both differentiable. It hits `face` (-1 on a miss) at
    `distance` (scene units, infinite on a miss).
    """

    origin: Float[Array, "B N 3"]
    direction: Float[Array, "B N 3"]
    face: Int[Array, "B N"]
    distance: Float[Array, "B N"]
    reached: Bool[Array, "B N"]


def delta_chain(
    packed: PackedScene,
    view: View,
    film_points: Float[Array, "N 2"],
    u: Float[Array, "B N 4"],
    rays: str,
    faces: Int[Array, "B N"] | None = None,
) -> ChainSegments:
    """The first B segments of paths from film points, as far as lobes are delta lobes.

    `u` are the numbers of all bounces, as `trace_paths` uses them. `faces` are the hits of a chain that was traced
    before: with them nothing is traced, and the chain goes over these faces.
    """
    origin, direction = view.rays(film_points)
    origin = jnp.broadcast_to(origin, direction.shape)
    start, reach = view.clipped(origin, direction)
    everywhere = jnp.ones(direction.shape[0], bool)

    def step(state, inputs):
        origin, direction, start, reach, reached = state
        (numbers, face), barycentric = inputs, None
        if faces is None:
            face, _, barycentric = intersect(packed, start, direction, reached, rays, reach)
        point = on_fixed_ray(packed, origin, direction, face, barycentric)
        scatterer = Scatterer(packed, point, -direction)
        delta = scatterer.sample_delta(numbers[:, 2:])
        goes_on = reached & point.valid & (stop_gradient(delta.probability) > 0)
        distance = jnp.where(point.valid, dot(point.position - origin, direction), jnp.inf)
        segment = ChainSegments(origin, direction, face, stop_gradient(distance), reached)
        onwards = jnp.where(goes_on[:, None], delta.wo, direction)
        position = jnp.where(goes_on[:, None], point.position, origin)
        return (position, onwards, scatterer.leave(onwards), jnp.full_like(reach, 1e30), goes_on), segment

    given = jnp.zeros(u.shape[:2], jnp.int32) if faces is None else faces
    return loops.scan(step, (origin, direction, start, reach, everywhere), (u, given))[1]
