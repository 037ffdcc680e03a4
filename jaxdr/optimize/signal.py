"""How much of a gradient can be relied on: its ratio of signal to noise, from gradients that are there anyway."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int


class Signal(NamedTuple):
    """Gradients of a round of all views so far, and of the round before.

    - `total`: sum over the `views` of this round; `previous`: mean over the views of the last one, of which there have
      been `rounds`.
    """

    total: Float[Array, "V 3"]
    previous: Float[Array, "V 3"]
    views: Int[Array, ""]
    rounds: Int[Array, ""]

    def observed(self, gradient: Float[Array, "V 3"], views: int) -> "Signal":
        """With the mean gradient over some more views."""
        return self._replace(total=self.total + views * gradient, views=self.views + views)

    def closed(self) -> tuple["Signal", float | None]:
        """The beginning of the next round, and the ratio of the last two; None after the first."""
        mean, nothing = self.total / self.views, jnp.zeros([], jnp.int32)
        ratio = signal_to_noise(self.previous, mean) if self.rounds > 0 else None
        return Signal(jnp.zeros_like(mean), mean, nothing, self.rounds + 1), ratio


def no_signal(latent: Float[Array, "V 3"]) -> Signal:
    """The beginning of the first round, for gradients of this shape."""
    return Signal(jnp.zeros_like(latent), jnp.zeros_like(latent), jnp.zeros([], jnp.int32), jnp.zeros([], jnp.int32))


def signal_to_noise(a: Float[Array, "V 3"], b: Float[Array, "V 3"]) -> float:
    """<a, b> / (|a - b|² / 2): power of what two estimates of a gradient share, over that in which one differs from it.

    For a = s + e, b = s + e' with independent errors it is |s|² / E|e|² in expectation of both parts. About zero (of
    either sign) for noise alone; negative where steps are so long that they go back and forth. Infinite where a and b
    are the same.
    """
    difference = float(((a - b) ** 2).sum()) / 2
    shared = float((a * b).sum())
    return shared / difference if difference > 0 else float("inf")
