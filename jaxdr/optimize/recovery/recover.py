"""Recovery of parameters: targets, steps of a method, and what is written of them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.compilation import jit
from jaxdr.optimize.checkpoint import Checkpoint, Place
from jaxdr.optimize.devices import Device, chosen_devices
from jaxdr.optimize.output import RunFolder, views_to_show
from jaxdr.optimize.planned import planned
from jaxdr.optimize.recovery.adam import AdamSteps
from jaxdr.optimize.recovery.config import RecoveryConfig
from jaxdr.optimize.recovery.errors import Errors
from jaxdr.optimize.recovery.least_squares import LeastSquaresSteps
from jaxdr.optimize.recovery.problem import Problem, build_problem
from jaxdr.optimize.run import Say, Task, run
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

    Raises as `jaxdr.optimize.run.run` does, and ValueError for a config that can't be run, or too few devices.
    """
    return run(RecoveryTask(config, chosen_devices(devices)), resume, overwrite)


class Current(NamedTuple):
    """What a step of the method changes, and the targets of the views."""

    state: Any
    targets: Float[np.ndarray, "N H W 3"]


class RecoveryTask(Task[Current]):
    """A call of `recover`."""

    def __init__(self, config: RecoveryConfig, devices: list[Device]):
        super().__init__(config, config.optimizer.iterations, devices)
        self.set_problem(build_problem(config))
        columns = ("iteration", *self.method.columns, "seconds", *self.errors.names)
        self.folder = RunFolder(config, columns, "recovery")
        self.plan: Plan | None = None

    def set_problem(self, problem: Problem) -> None:
        """What is optimised, and all that is made for it."""
        self.problem = problem
        key, optimizer = jax.random.fold_in(self.key, STEPS), self.config.optimizer
        self.method: Any = METHODS[optimizer.kind](self.config, optimizer, problem, key, self.devices)
        self.errors = Errors(problem, self.config)
        self.image = jit(problem.image, static_argnums=4)

    def plan_integrator(self) -> None:
        """Where the config leaves the integrator to a plan, measure derivatives of the scene at its start."""
        options, names = self.config.integrator, [parameter.name for parameter in self.config.parameters]
        scene, spp = self.problem.scene.replace(self.problem.values(self.problem.start())), self.config.samples.gradient
        key = jax.random.fold_in(self.key, PLAN)
        self.plan = planned(options, scene, names, spp, key, self.folder)
        if self.plan is not None:
            self.set_problem(self.problem._replace(integrator=self.plan.integrator))

    def begin(self, saved: Checkpoint | None) -> Current:
        """The first state, or that of the checkpoint. A method may look at the targets before its first step."""
        if self.config.integrator.planned:
            self.plan_integrator()
        targets = self.targets()
        state = self.method.fresh(targets) if saved is None else saved.state(self.method.template(targets))
        return Current(state, targets)

    def step(self, current: Current, done: int, say: Say) -> tuple[Current, dict]:
        """Do a step of the method; now and then, and after the last, measure the errors of its result."""
        state, row = self.method.step(current.state, current.targets, done)
        after = current._replace(state=state)
        if self.last(after, done + 1) or (done + 1) % self.config.report.errors == 0:
            row |= self.errors(self.method.latents(state))
        return after, row

    def last(self, current: Current, done: int) -> bool:
        """Whether the method has done all iterations, or would do no more."""
        return done == self.steps or self.method.done(current.state)

    def shown(self, current: Current, row: dict) -> dict[str, float]:
        return {name: row[name] for name in self.method.columns}

    def saved(self, current: Current, done: int) -> tuple[Place, Any]:
        return Place(done, self.seconds()), current.state

    def targets(self) -> Float[np.ndarray, "N H W 3"]:
        """Target views: read, rendered, or read back when a run is resumed."""
        images, scene, spp = self.problem.images, self.problem.target, self.config.samples.target
        if images is None:
            image, key = jit(self.problem.target_image, static_argnums=3), jax.random.fold_in(self.key, TARGETS)
            images = rendered(lambda *view: image(scene, *view, spp), self.poses(), key, self.interruption)
        return target_views(self.folder, images)

    def finish(self, current: Current, done: int) -> dict:
        """Write the values that were found."""
        before, after, targets = self.problem.start(), self.method.latents(current.state), current.targets
        errors = [self.errors(latents) for latents in (before, after)]
        values = {name: np.asarray(value) for name, value in self.problem.values(after).items()}
        summary = {
            "iterations": done,
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
        return summary

    def poses(self) -> Float[Array, "N 4 4"]:
        return jnp.asarray(self.problem.views, float)

    def loss(self, latents, targets) -> float:
        """Mean squared difference of all views."""
        key, spp = jax.random.fold_in(self.key, LOSS), self.config.samples.pictures
        images = [self.image(self.problem.scene, latents, pose, key, spp) for pose in self.poses()]
        return float(((np.stack(images) - targets) ** 2).mean())

    def draw(self, current: Current, done: int, say: Say) -> None:
        """A grid of some views; meshes and textures that are recovered."""
        latents, scene, spp = self.method.latents(current.state), self.problem.scene, self.config.samples.pictures
        shown = views_to_show(self.config.report.views, len(self.problem.views))
        poses, key = self.poses(), jax.random.fold_in(self.key, PICTURES)
        images = np.stack([self.image(scene, latents, poses[view], key, spp) for view in shown])

        def save():
            self.folder.save_grid(done, current.targets[shown], images)
            for name, value in self.problem.values(latents).items():
                name, _, what = name.rpartition(".")
                if what == "vertices":
                    self.folder.save_mesh(f"{done:05d}.{name}", scene.shapes[name].mesh.with_vertices(value))
                elif what == "pixels":
                    self.folder.save_texture(f"{done:05d}.{name}", np.asarray(value))

        shown_if_possible(done, save, say)
