"""Primary numbers of emitter samples: the inverse of `sample_emitter`."""

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.scene.packed import PackedScene
from jaxdr.scene.sampling import number_in_rows, uniform_triangle_numbers
from jaxdr.transport.interaction import SurfacePoint


def emitter_numbers(
    packed: PackedScene, point: SurfacePoint, direction: Float[Array, "N 3"]
) -> tuple[Float[Array, "N 2"], Bool[Array, " N"]]:
    """(numbers from which `sample_emitter` draws `point`, or on a miss `direction`; whether they exist). Detached.

    They do not exist for surfaces that emit no light.
    """
    u, found = jnp.zeros_like(direction[:, :2]), jnp.zeros_like(point.valid)
    environment = packed.environment_sampler is not None
    if packed.environment_sampler is not None:
        u, found = packed.environment_sampler.numbers(stop_gradient(direction)), ~point.valid
    if packed.emitter_faces is not None:
        faces, cdf = packed.emitter_faces, packed.emitter_cdf
        place = jnp.full(packed.faces.shape[0], -1).at[faces].set(jnp.arange(faces.shape[0]))[point.face]
        glows = point.valid & (place >= 0)
        inside = uniform_triangle_numbers(point.barycentric)
        number = number_in_rows(cdf[None], jnp.zeros_like(place), jnp.maximum(place, 0), inside[:, 0])
        u = jnp.where(glows[:, None], jnp.stack([number, inside[:, 1]], -1), u)
        found = found | glows
    if packed.choice is not None:
        kind = jnp.where(point.valid, int(environment), 0)
        u = u.at[:, 0].set(number_in_rows(packed.choice[None], jnp.zeros_like(kind), kind, u[:, 0]))
    return stop_gradient(u), found
