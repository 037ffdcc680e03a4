"""Recovery with Levenberg-Marquardt (optimistix), from forward-mode Jacobians of all views on fixed random numbers."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.compilation import jit
from jaxdr.optimize.devices import Device
from jaxdr.optimize.phase import finite
from jaxdr.optimize.progress import NotFinite
from jaxdr.optimize.recovery.config import LevenbergMarquardt, RecoveryConfig
from jaxdr.optimize.recovery.problem import Latents, Problem
from jaxdr.scene.scene import Scene

MOST = 256  # numbers: a derivative image of every view is held for each
REJECTED = 3  # steps in a row, each a quarter as bold: nothing that the noise of the Jacobian lets pass is left to gain
GOOD = 0.75  # share of the predicted reduction from which on the damping falls (optimistix: 0.99, noise rarely allows)


class Arguments(NamedTuple):
    """What the residuals depend on beside the numbers; constants for the solver.

    - `scales`: what the numbers are multiplied by.
    - `rows`, `columns`: Gaussian filters of the rows and columns of an image.
    """

    scene: Scene
    keys: PRNGKeyArray
    targets: Float[Array, "N H W 3"]
    scales: Float[Array, " n"]
    rows: Float[Array, "H H"]
    columns: Float[Array, "W W"]


class LeastSquaresState(NamedTuple):
    """Numbers times `scales`, in one vector; the solver's own state; and which blur it works with since what iteration.

    Scales are proportional to the norms of the Jacobian's columns at the start: a scaled number's change by one changes
    the images as much, whatever its unit (Moré 1978, "The Levenberg-Marquardt algorithm").
    """

    scaled: Float[Array, " n"]
    solver: Any
    scales: Float[Array, " n"]
    stage: Array
    since: Array


class LeastSquaresSteps:
    """The method of a run. Residuals are the differences of all pixels, divided by the norm of all targets.

    Image and Jacobian use independent keys, the same in all iterations. So the residuals are one function, which a
    trust region can judge. The noise of one is not in the other. So where the iterations end, J^T r = 0 has no bias to
    first order.
    """

    columns = ("loss", "trust")

    def __init__(
        self,
        config: RecoveryConfig,
        options: LevenbergMarquardt,
        problem: Problem,
        key: Array,
        devices: Sequence[Device],
    ):
        del devices  # derivative images of all views come one after the other
        self.samples, self.options, self.problem = config.samples, options, problem
        self.keys = jax.random.split(key, len(problem.views))
        self.start, self.unravel = ravel_pytree(problem.start())
        if len(self.start) > MOST:
            raise ValueError(
                f'optimizer.kind: "levenberg_marquardt" takes at most {MOST} numbers, each costs a derivative image; '
                f'{", ".join(problem.parameters)} are {len(self.start)}; take "adam"'
            )
        self.stretch = options.damping**-0.5  # of the scaled Jacobian's columns: a damping of 1 is relative to that
        solver = optimistix.LevenbergMarquardt(0.0, options.tolerance / self.stretch, norm=optimistix.two_norm)
        search = optimistix.ClassicalTrustRegion(high_cutoff=GOOD)
        self.solver = eqx.tree_at(lambda s: s.search, solver, search)
        self.solver_start: Any = None
        self.residuals, self.jacobian, self.advance = self._functions()

    def fresh(self, targets: Float[np.ndarray, "N H W 3"]) -> LeastSquaresState:
        """The state at the start. Raises ValueError for a number that the images do not depend on, and `NotFinite`."""
        jacobian = self.jacobian(self.start, self._arguments(targets, jnp.ones_like(self.start), 0))
        if not finite(jacobian):
            raise NotFinite("the Jacobian is not finite at the start")
        scales = jnp.linalg.norm(jacobian, axis=0) / self.stretch
        for name, scale in self.unravel(scales).items():
            if not np.asarray(scale).all():
                raise ValueError(f"{name}: the images do not depend on all of it at the start; begin where they do")
        return self._begin(targets, self.start * scales, scales, 0, 0)

    def template(self, targets: Float[np.ndarray, "N H W 3"]) -> LeastSquaresState:
        """A state of the same structure whose numbers mean nothing. It is made without rendering."""
        return self._begin(targets, self.start, jnp.ones_like(self.start), 0, 0)

    def latents(self, state: LeastSquaresState) -> Latents:
        """Latent numbers of a state: the last accepted ones."""
        return self.unravel(state.scaled / state.scales)

    def done(self, state: LeastSquaresState) -> bool:
        """Whether the solver has finished with the last blur."""
        return self._through(state) and int(state.stage) == len(self.options.blur) - 1

    def _through(self, state: LeastSquaresState) -> bool:
        return bool(state.solver.terminate) or int(state.solver.num_steps_since_acceptance) >= REJECTED

    def step(
        self, state: LeastSquaresState, targets: Float[np.ndarray, "N H W 3"], iteration: int
    ) -> tuple[LeastSquaresState, dict]:
        """The state after one more rendering of images and Jacobian, and its row of the metrics. Raises `NotFinite`.

        The first one with a blur is of the numbers at hand, which are kept. `loss` is the mean squared difference of
        the filtered images for the last accepted numbers, `trust` the inverse of the damping.
        """
        stage, stages = int(state.stage), len(self.options.blur)
        share = (self.options.iterations - int(state.since)) // (stages - stage)
        if stage < stages - 1 and (self._through(state) or iteration - int(state.since) >= share):
            state = self._begin(targets, state.scaled, state.scales, stage + 1, iteration)
        arguments = self._arguments(targets, state.scales, int(state.stage))
        scaled, solver = self.advance(state.scaled, state.solver, arguments)
        if not finite((scaled, solver)):
            raise NotFinite(f"images or derivatives are not finite in step {iteration + 1}")
        loss = float((np.asarray(solver.f_info.residual) ** 2).sum() * (np.asarray(targets) ** 2).mean())
        row = {"loss": loss, "trust": float(solver.search_state.step_size)}
        return state._replace(scaled=scaled, solver=solver), row

    def _begin(self, targets, scaled, scales, stage: int, iteration: int) -> LeastSquaresState:
        if self.solver_start is None:  # made once: it holds a traced function, and another one would compile anew
            arguments = self._arguments(targets, scales, stage)
            function = _with_aux(self.residuals)
            structure = jax.eval_shape(self.residuals, scaled, arguments)
            self.solver_start = self.solver.init(function, scaled, arguments, {}, structure, None, frozenset())
        solver = eqx.tree_at(lambda state: state.y_eval, self.solver_start, scaled)
        return LeastSquaresState(scaled, solver, scales, jnp.asarray(stage), jnp.asarray(iteration))

    def _arguments(self, targets, scales, stage: int) -> Arguments:
        dtype, (height, width) = self.start.dtype, targets.shape[1:3]
        rows, columns = (jnp.asarray(gaussian_filter(n, self.options.blur[stage]), dtype) for n in (height, width))
        return Arguments(self.problem.scene, self.keys, jnp.asarray(targets, dtype), scales, rows, columns)

    def _functions(self) -> tuple[Callable, Callable, Callable]:
        """Residuals of scaled numbers, jitted Jacobian by the numbers themselves, jitted step of the solver."""
        samples, image = self.samples, self.problem.image
        views = jnp.asarray(self.problem.views, float)

        def filtered(image, arguments):
            norm = jnp.sqrt((arguments.targets**2).sum())
            return jnp.einsum("ij,jk...,lk->il...", arguments.rows, image, arguments.columns) / norm

        def differences(numbers, arguments):
            def view(inputs):
                pose, key, target = inputs
                seen = image(arguments.scene, self.unravel(numbers), pose, jax.random.split(key)[0], samples.image)
                return filtered(seen - target, arguments)

            return jax.lax.map(view, (views, arguments.keys, arguments.targets)).ravel()

        def jacobian(numbers, arguments):
            def column(inputs):
                (pose, key), direction = inputs
                key = jax.random.split(key)[1]

                def seen(x):
                    return image(arguments.scene, self.unravel(x), pose, key, samples.gradient)

                return filtered(jax.jvp(seen, (numbers,), (direction,))[1], arguments)

            # One after another: memory does not grow with the numbers.
            basis = jnp.eye(len(numbers), dtype=numbers.dtype)

            def view(inputs):
                return jax.lax.map(lambda direction: column((inputs, direction)), basis)

            found = jax.lax.map(view, (views, arguments.keys))
            return jnp.moveaxis(found, 1, -1).reshape(-1, len(numbers))

        @jax.custom_jvp
        def residuals(scaled, arguments):
            return differences(scaled / arguments.scales, arguments)

        @residuals.defjvp
        def _(primals, tangents):
            scaled, arguments = primals  # the arguments are constants
            derivative = jacobian(scaled / arguments.scales, arguments) / arguments.scales
            return residuals(scaled, arguments), derivative @ tangents[0]

        @eqx.filter_jit
        def advance(scaled, state, arguments):
            scaled, state, _ = self.solver.step(_with_aux(residuals), scaled, arguments, {}, state, frozenset())
            return scaled, state

        return residuals, jit(jacobian), advance


def gaussian_filter(count: int, deviation: float) -> Float[np.ndarray, "n n"]:
    """Matrix that filters a row of pixels with a Gaussian, each with weights that sum to one; the identity for 0."""
    if deviation == 0:
        return np.eye(count)
    apart = np.subtract.outer(np.arange(count), np.arange(count))
    weights = np.exp(-0.5 * (apart / deviation) ** 2)
    return weights / weights.sum(1, keepdims=True)


def _with_aux(function: Callable) -> Callable:
    return lambda y, args: (function(y, args), None)
