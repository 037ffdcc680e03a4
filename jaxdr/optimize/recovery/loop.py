"""The loop of a recovery: targets, steps of a method, metrics, pictures, checkpoints."""

import time
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.compilation import jit
from jaxdr.optimize.checkpoint import Place
from jaxdr.optimize.devices import Device, chosen_devices
from jaxdr.optimize.output import RunFolder, views_to_show
from jaxdr.optimize.planned import planned
from jaxdr.optimize.processes import any_process, run_in
from jaxdr.optimize.progress import Interrupted, Interruption, NotFinite, Progress
from jaxdr.optimize.recovery.adam import AdamSteps
from jaxdr.optimize.recovery.config import RecoveryConfig
from jaxdr.optimize.recovery.errors import Errors
from jaxdr.optimize.recovery.least_squares import LeastSquaresSteps
from jaxdr.optimize.recovery.problem import Problem, build_problem
from jaxdr.optimize.run_files import shown_if_possible
from jaxdr.optimize.targets import rendered, target_views
from jaxdr.plan.report import Plan

METHODS = {"adam": AdamSteps, "levenberg_marquardt": LeastSquaresSteps}
# Streams of random numbers under the run's seed.
TARGETS, STEPS, PICTURES, LOSS, PLAN = 0, 1, 2, 3, 4


def recover(
    config: RecoveryConfig, *, resume: bool = False, overwrite: bool = False, devices: int | None = None
) -> dict:
    """Run a config to its end and return the summary that `metrics.json` holds.

    The summary has start and end of every measure that `Errors` knows, in `errors`. `loss_initial` and `loss_final` are
    mean squared differences of all views.

    `devices`: how many of JAX's devices share the work of Adam, by default all; least squares take one. Every random
    number derives from the seed and the iteration. So a run that was interrupted and is resumed ends with the same
    bits.

    - Raises ValueError for a config that can't be run, a folder in use, or too few devices.
    - Raises `Interrupted` after Ctrl-C or SIGTERM, and `Stopped` where a checkpoint or result can't be written.
    - Raises `NotFinite` rather than go on with NaN, and `ProcessLost`.
    """
    run = _Run(config, chosen_devices(devices))
    with run_in(run, resume, overwrite):
        return run.run(resume)


class _Run:
    """One call of `recover`."""

    def __init__(self, config: RecoveryConfig, devices: list[Device]):
        self.config, self.devices = config, devices
        self.key = jax.random.key(config.seed)
        self.set_problem(build_problem(config))
        self.folder = RunFolder(config, ("iteration", *self.method.columns, "seconds", *self.errors.names))
        self.plan: Plan | None = None
        self.interruption = Interruption()
        self.clock = time.monotonic()

    def set_problem(self, problem: Problem) -> None:
        """What is optimised, and all that is made for it."""
        self.problem = problem
        key, optimizer = jax.random.fold_in(self.key, STEPS), self.config.optimizer
        self.method: Any = METHODS[optimizer.kind](self.config, optimizer, problem, key, self.devices)
        self.errors = Errors(problem, self.config)
        self.image = jit(problem.image, static_argnums=4)

    def plan_integrator(self, resume: bool) -> None:
        """Where the config leaves the integrator to a plan: of derivatives of the scene at its start."""
        options, names = self.config.integrator, [parameter.name for parameter in self.config.parameters]
        scene, spp = self.problem.scene.replace(self.problem.values(self.problem.start())), self.config.samples.gradient
        key = jax.random.fold_in(self.key, PLAN)
        self.plan = planned(options, scene, names, spp, key, self.folder, resume)
        if self.plan is not None:
            self.set_problem(self.problem._replace(integrator=self.plan.integrator))

    def run(self, resume: bool) -> dict:
        total = self.config.optimizer.iterations
        if self.config.integrator.planned:
            self.plan_integrator(resume)
        targets = self.targets(resume)
        saved = self.folder.load_checkpoint() if resume else None
        if saved is not None:
            state, iteration = saved.state(self.method.template(targets)), saved.place.step
            self.clock -= saved.place.seconds
        else:
            state, iteration = self.method.fresh(targets), 0
        self.folder.start_metrics(iteration)
        if iteration == 0:
            self.save_checkpoint(state, 0)  # from here on a run without a checkpoint has lost it
            self.save_pictures(state, targets, 0)

        with Progress("optimise", total, iteration) as progress:
            while iteration < total and not self.method.done(state):
                try:
                    after, row = self.method.step(state, targets, iteration)
                except NotFinite as problem:
                    self.stop(state, iteration, problem)
                state, iteration = after, iteration + 1
                last = iteration == total or self.method.done(state)
                if last or iteration % self.config.report.errors == 0:
                    row |= self.errors(self.method.latents(state))
                self.folder.add_metrics({**row, "iteration": iteration, "seconds": round(self.seconds(), 2)})
                progress.step(**{name: row[name] for name in self.method.columns})
                if last or iteration % self.config.report.pictures == 0:
                    self.save_pictures(state, targets, iteration)
                stop = any_process(self.interruption.requested)
                if last or iteration % self.config.report.checkpoint == 0 or stop:
                    self.save_checkpoint(state, iteration)
                if stop and not last:
                    raise Interrupted(f"stopped after step {iteration}; checkpoint in {self.folder.checkpoint}")
        return self.finish(state, targets, iteration)

    def stop(self, state: Any, iteration: int, problem: NotFinite) -> NoReturn:
        """Keep the state before a step that failed, and say so."""
        self.save_checkpoint(state, iteration)
        raise NotFinite(f"{problem}; the state before that step is in {self.folder.checkpoint}") from None

    def save_checkpoint(self, state: Any, iteration: int) -> None:
        self.folder.save_checkpoint(Place(iteration, self.seconds()), state)

    def targets(self, resume: bool) -> Float[np.ndarray, "N H W 3"]:
        """Target views: read, rendered, or read back when a run is resumed."""
        images, scene, spp = self.problem.images, self.problem.target, self.config.samples.target
        if images is None:
            image, key = jit(self.problem.target_image, static_argnums=3), jax.random.fold_in(self.key, TARGETS)
            images = rendered(lambda *view: image(scene, *view, spp), self.poses(), key, self.interruption)
        return target_views(self.folder, resume, images)

    def finish(self, state: Any, targets, iteration: int) -> dict:
        """Write result and summary."""
        before, after = self.problem.start(), self.method.latents(state)
        errors = [self.errors(latents) for latents in (before, after)]
        values = {name: np.asarray(value) for name, value in self.problem.values(after).items()}
        summary = {
            "iterations": iteration,
            "seconds": round(self.seconds(), 2),
            "loss_initial": self.loss(before, targets),
            "loss_final": self.loss(after, targets),
            "errors": {name: [errors[0][name], errors[1][name]] for name in self.errors.names},
            "values": {name: value.tolist() for name, value in values.items() if value.size <= 16},
            "device": jax.devices()[0].device_kind,
        }
        if self.plan is not None:
            summary["plan"] = self.plan.to_dict()
        self.folder.save_values(values)
        self.folder.save_summary(summary)
        return summary

    def seconds(self) -> float:
        return time.monotonic() - self.clock

    def poses(self) -> Float[Array, "N 4 4"]:
        return jnp.asarray(self.problem.views, float)

    def loss(self, latents, targets) -> float:
        """Mean squared difference of all views."""
        key, spp = jax.random.fold_in(self.key, LOSS), self.config.samples.pictures
        images = [self.image(self.problem.scene, latents, pose, key, spp) for pose in self.poses()]
        return float(((np.stack(images) - targets) ** 2).mean())

    def save_pictures(self, state: Any, targets, iteration: int) -> None:
        latents = self.method.latents(state)
        shown = views_to_show(self.config.report.views, len(self.problem.views))
        poses, key = self.poses(), jax.random.fold_in(self.key, PICTURES)
        images = np.stack(
            [self.image(self.problem.scene, latents, poses[view], key, self.config.samples.pictures) for view in shown]
        )

        def save():
            self.folder.save_grid(iteration, targets[shown], images)
            for name, value in self.problem.values(latents).items():
                name, _, what = name.rpartition(".")
                if what == "vertices":
                    mesh = self.problem.scene.shapes[name].mesh.with_vertices(value)
                    self.folder.save_mesh(f"{iteration:05d}.{name}", mesh)
                elif what == "pixels":
                    self.folder.save_texture(f"{iteration:05d}.{name}", np.asarray(value))

        shown_if_possible(iteration, save)
