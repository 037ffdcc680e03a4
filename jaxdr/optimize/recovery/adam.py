"""Recovery with Adam: a few views a step, new random numbers every step, a learning rate for every parameter."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from jaxdr.compilation import jit
from jaxdr.optimize.devices import Device, Divided, divide
from jaxdr.optimize.phase import check_finite, items_of_step, view_gradient
from jaxdr.optimize.problem import views_of_step
from jaxdr.optimize.recovery.config import Adam, Parameter, RecoveryConfig
from jaxdr.optimize.recovery.problem import Latents, Problem


class AdamState(NamedTuple):
    """Latent numbers and the moments of their optimisers, by name."""

    latents: Latents
    moments: dict[str, optax.OptState]


class AdamSteps:
    """Adam as the method of a run; every step is given the targets."""

    columns = ("loss", "gradient_norm")

    def __init__(self, config: RecoveryConfig, options: Adam, problem: Problem, key: Array, devices: Sequence[Device]):
        self.seed, self.options, self.problem, self.key = config.seed, options, problem, key
        samples = config.samples
        self.optimizers = {
            parameter.name: problem.parameters[parameter.name].adam(learning_rate(parameter, options.iterations))
            for parameter in config.parameters
        }

        division = divide(options.views_per_step, len(devices), min(samples.image, samples.gradient))

        def gradient(common, view):
            scene, latents = common
            image = partial(problem.image, scene)
            return view_gradient(image, options.loss, samples.image, samples.gradient, division)(latents, *view)

        self.gradients, self.update = Divided(gradient, division, devices), jit(self._update)

    def fresh(self, targets: Float[np.ndarray, "N H W 3"]) -> AdamState:
        """The state at the start."""
        del targets
        latents = self.problem.start()
        return AdamState(latents, {name: made.init(latents[name]) for name, made in self.optimizers.items()})

    template = fresh

    def latents(self, state: AdamState) -> Latents:
        """Latent numbers of a state."""
        return state.latents

    def done(self, state: AdamState) -> bool:
        """Whether another step would change nothing."""
        del state
        return False

    def step(self, state: AdamState, targets: Float[np.ndarray, "N H W 3"], iteration: int) -> tuple[AdamState, dict]:
        """The state after a step, and its row of the metrics. Raises `NotFinite`."""
        key, views = jax.random.fold_in(self.key, iteration), self.problem.views
        chosen = views_of_step(len(views), self.options.views_per_step, iteration, self.seed)
        items = items_of_step(jnp.asarray(views, float), targets, chosen, key)
        losses, parts = [], []
        found = self.gradients((self.problem.scene, state.latents), items)
        for view, (loss, part) in zip(chosen, found, strict=True):
            check_finite(view, loss, part, iteration + 1)
            losses.append(float(loss))
            parts.append(part)
        gradient = jax.tree.map(lambda *leaves: sum(leaves) / len(chosen), *parts)
        row = {"loss": sum(losses) / len(losses), "gradient_norm": float(optax.tree.norm(gradient))}
        return self.update(state, gradient), row

    def _update(self, state: AdamState, gradient: Latents) -> AdamState:
        latents, moments = {}, {}
        for name, optimizer in self.optimizers.items():
            updates, moments[name] = optimizer.update(gradient[name], state.moments[name], state.latents[name])
            latents[name] = optax.apply_updates(state.latents[name], updates)
        return AdamState(latents, moments)


def learning_rate(parameter: Parameter, iterations: int) -> float | optax.Schedule:
    """Constant, or exponential decay over all iterations."""
    first, last = parameter.learning_rate, parameter.final_learning_rate
    assert first is not None  # the config has checked it
    return first if last is None else optax.exponential_decay(first, iterations, last / first)
