"""Adam with one step size for all components."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Int, PyTree

from jaxdr.argument_kinds import checked


class AdamUniformState(NamedTuple):
    """Number of steps so far, first and second moments of the gradient."""

    count: Int[Array, ""]
    mu: PyTree
    nu: PyTree


@checked
def adam_uniform(
    learning_rate: optax.ScalarOrSchedule, b1: float = 0.9, b2: float = 0.999, eps: float = 1e-8
) -> optax.GradientTransformation:
    """Adam for meshes (Nicolet, Jacobson and Jakob 2021, "AdamUniform"): an optax transformation.

    The second moment is one number for each array, its largest component. Adam's own, one for each component, would
    undo the smoothness that `LargeSteps` gives the gradient. `learning_rate` is a number or an optax schedule (a
    function of the step count, from 0). Raises ValueError for `b1` or `b2` outside [0, 1), or a negative `eps`.
    """
    return optax.chain(scale_by_adam_uniform(b1, b2, eps), optax.scale_by_learning_rate(learning_rate))


def scale_by_adam_uniform(b1: float = 0.9, b2: float = 0.999, eps: float = 1e-8) -> optax.GradientTransformation:
    """`adam_uniform` without the learning rate: m / (sqrt(max n) + eps), m and n corrected for their start at zero.

    Raises ValueError unless 0 <= b1 < 1, 0 <= b2 < 1 and eps >= 0.
    """
    if not (0 <= b1 < 1 and 0 <= b2 < 1 and eps >= 0):
        raise ValueError(f"adam_uniform: need 0 <= b1 < 1, 0 <= b2 < 1 and eps >= 0; got {b1}, {b2} and {eps}")

    def init(params):
        zeros = optax.tree.zeros_like(params)
        return AdamUniformState(jnp.zeros([], jnp.int32), zeros, zeros)

    def update(updates, state, params=None):
        del params
        mu = optax.tree.update_moment(updates, state.mu, b1, 1)
        nu = optax.tree.update_moment(updates, state.nu, b2, 2)
        count = state.count + 1

        def scaled(m, n):
            first = m / (1 - b1**count).astype(m.dtype)
            second = jnp.max(n, initial=0.0) / (1 - b2**count).astype(n.dtype)
            return first / (jnp.sqrt(second) + eps)

        return jax.tree.map(scaled, mu, nu), AdamUniformState(count, mu, nu)

    return optax.GradientTransformation(init, update)
