"""The radiance that a path tracer gathers, by the length of the paths."""

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.transport.path import Vertex, gather
from jaxdr.transport.path_settings import PathSettings


def radiance_by_depth(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Float[Array, "D N 3"]:
    """Radiance towards the camera: row k is that of paths of k + 1 segments, D = `settings.max_depth`.

    Differentiable; the sum of the rows is the radiance of `trace_paths`, from the same numbers.
    """
    seen = emitted(packed, first, -direction)[None]
    if settings.max_depth == 1:
        return seen
    start = Vertex(first, -direction, jnp.ones_like(direction))
    parts = gather(packed, start, settings.max_depth - 1, u, key, settings, None)
    return jnp.concatenate([seen, parts.light + parts.emission])
