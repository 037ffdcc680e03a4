"""Optimisation of a shape: from rendered target views and a sphere to a mesh."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.chamfer import chamfer
from jaxdr.optimize.checkpoint import Checkpoint, Place
from jaxdr.optimize.config import Level, OptimizeConfig, Remesh
from jaxdr.optimize.devices import Device, chosen_devices
from jaxdr.optimize.field_aligned import remesh_field_aligned, require_pyinstantmeshes
from jaxdr.optimize.folds import COLLAPSED, collapse_message, folded_share
from jaxdr.optimize.output import RunFolder, views_to_show
from jaxdr.optimize.phase import Phase, Programs, State, check_finite, items_of_step, make_phase, make_programs
from jaxdr.optimize.planned import planned
from jaxdr.optimize.problem import OBJECT, build_problem, views_of_step
from jaxdr.optimize.processes import mesh_of_writer
from jaxdr.optimize.remesh import remesh, remesh_to, require_gpytoolbox
from jaxdr.optimize.run import Say, Task, run
from jaxdr.optimize.run_files import shown_if_possible
from jaxdr.optimize.signal import signal_to_noise
from jaxdr.optimize.targets import rendered, target_views
from jaxdr.plan.report import Plan

# Streams of random numbers under the run's seed.
TARGETS, STEPS, PICTURES, PLAN, SECOND = range(5)  # SECOND: for the second estimate of a step that is estimated twice


def optimize(
    config: OptimizeConfig, *, resume: bool = False, overwrite: bool = False, devices: int | None = None
) -> dict:
    """Run a config to its end and return the summary that `metrics.json` holds.

    `devices`: how many of JAX's devices share the work, by default all, those of other processes too. Every random
    number derives from the seed and the iteration. So a run that was interrupted and is resumed ends with the same
    bits.

    Raises as `jaxdr.optimize.run.run` does; ValueError for a config that can't be run, or too few devices; ImportError
    before the start, where remeshing is asked for and not installed.
    """
    beside = ThreadPoolExecutor(1, "jaxdr ahead")
    try:
        return run(ShapeTask(config, chosen_devices(devices), beside), resume, overwrite)
    finally:
        beside.shutdown(cancel_futures=True)


def is_field_aligned(to: Level | Remesh) -> bool:
    return isinstance(to, Remesh) and to.field_aligned


def with_new_topology(mesh: Mesh, to: Level | Remesh) -> Mesh:
    """The same surface as `to` asks for it. Raises ValueError where remeshing fails."""
    if is_field_aligned(to):
        return remesh_field_aligned(mesh, to.vertices)
    return remesh_to(mesh, to.vertices) if to.vertices else remesh(mesh, to.edge_length)


class Current(NamedTuple):
    """What is compiled for a mesh and level, what a step changes, the level's targets, the last Chamfer distance."""

    phase: Phase
    state: State
    targets: Float[np.ndarray, "N H W 3"]
    distance: float


class ShapeTask(Task[Current]):
    """A call of `optimize`; `beside` is another thread, which prepares what the next level needs."""

    def __init__(self, config: OptimizeConfig, devices: list[Device], beside: ThreadPoolExecutor):
        super().__init__(config, config.optimizer.iterations, devices)
        self.folder = RunFolder(config)
        self.problem = build_problem(config)
        self.initial = self.problem.scene.shapes[OBJECT].mesh
        options = config.optimizer
        self.remeshing = {i: remesh for remesh in options.remesh for i in remesh.steps(options.iterations)}
        self.stages = config.stages()
        sizes = [*self.remeshing.values(), *(stage for stage in self.stages if stage.remeshes)]
        if any(is_field_aligned(to) for to in sizes):
            require_pyinstantmeshes()  # an error now, not after an hour
        if not all(is_field_aligned(to) for to in sizes):
            require_gpytoolbox()
        self.plan: Plan | None = None
        self.programs: list[Programs] = []  # one for each level, made once the integrator is known
        self.beside = beside
        self.compiled, self.coming = Future(), Future()  # the first level's gradient; the next level's targets
        self.rendered: dict[int, np.ndarray] = {}  # target views by their resolution
        self.collapsed = False
        self.folded_at_start = folded_share(self.initial)

    def begin(self, saved: Checkpoint | None) -> Current:
        """The first phase, or that of the checkpoint.

        The gradient compiles in the other thread while targets are rendered.
        """
        self.plan_integrator()
        self.programs = self.level_programs()
        phase, state = self.fresh() if saved is None else self.restored(saved)
        self.compiled = self.ahead(self.compile, phase.level, phase.mesh)
        targets = self.targets(phase.level)
        self.look_ahead(phase)
        if saved is None:
            self.folder.save_mesh("target", self.problem.target)
        return Current(phase, state, targets, self.chamfer(phase, state))

    def level_programs(self) -> list[Programs]:
        """What renders the views of each level, and their gradients."""
        return make_programs(self.config, self.problem, self.devices)

    def plan_integrator(self) -> None:
        """Where the config leaves the integrator to a plan, measure derivatives of the first view by the vertices."""
        options, scene, spp = self.config.integrator, self.problem.scene, self.config.samples.gradient
        key = jax.random.fold_in(self.key, PLAN)
        self.plan = planned(options, scene, [f"{OBJECT}.vertices"], spp, key, self.folder)
        if self.plan is not None:
            self.problem = self.problem._replace(integrator=self.plan.integrator)

    def fresh(self) -> tuple[Phase, State]:
        phase = make_phase(self.config, self.programs[0], self.initial, 0)
        return phase, phase.fresh_state()

    def restored(self, saved: Checkpoint) -> tuple[Phase, State]:
        """Phase and state of a checkpoint."""
        place, mesh = saved.place, self.initial
        if place.start > 0:
            mesh = Mesh(place.vertices, place.faces)
            mesh = mesh.smooth() if self.config.initial.shading == "smooth" else mesh
        phase = make_phase(self.config, self.programs[place.level], mesh, place.start, place.level, place.since)
        return phase, saved.state(phase.fresh_state())

    def targets(self, level: int, quiet: bool = False) -> Float[np.ndarray, "N H W 3"]:
        """Target views of a level: rendered, or read back when a run is resumed."""
        mesh, spp, last = self.problem.target, self.config.samples.target, level + 1 == len(self.stages)
        image, resolution = self.programs[level].image, self.stages[level].resolution
        key = jax.random.fold_in(self.key, TARGETS)
        images = self.rendered.get(resolution)
        if images is None:
            images = rendered(lambda *view: image(mesh, *view, spp), self.poses(), key, self.interruption, quiet)
        self.rendered[resolution] = target_views(self.folder, images, None if last else level)
        return self.rendered[resolution]

    def look_ahead(self, phase: Phase) -> None:
        """Prepare the level after that of `phase`, if there is one, in the other thread."""
        if phase.level + 1 < len(self.stages):
            self.coming = self.ahead(self.prepared, phase.level + 1, phase.mesh)

    def ahead(self, function: Callable, *arguments) -> Future:
        """Call a function in the other thread, after those called before it, and with this thread's precision."""
        x64 = jax.dtypes.canonicalize_dtype(float) == np.float64

        def called():
            with jax.enable_x64(x64):
                return function(*arguments)

        return self.beside.submit(called)

    def prepared(self, level: int, mesh: Mesh) -> Float[np.ndarray, "N H W 3"]:
        """Target views of a level. Its gradient is compiled too, if the number of its faces is known already."""
        stage = self.stages[level]
        targets = self.targets(level, quiet=True)
        if stage.edge_length > 0 or (self.programs[level] is self.programs[level - 1] and not stage.vertices):
            return targets
        try:
            mesh = remesh_to(mesh, stage.vertices) if stage.vertices else mesh
        except ValueError:  # the mesh will be another one when the level begins, and remeshing may succeed
            return targets
        self.compile(level, mesh)
        return targets

    def compile(self, level: int, mesh: Mesh) -> None:
        """Compile the gradient of a level for meshes like this one, by calling it."""
        resolution = self.stages[level].resolution
        target = jnp.zeros((resolution, resolution, 3), mesh.vertices.dtype)
        self.programs[level].gradient.compile(mesh, (self.poses()[0], target, self.key))

    def preparing(self, current: Current, done: int) -> str:
        """Another mesh or level has programs of its own."""
        return "compiling" if done in self.remeshing or done in (current.phase.start, current.phase.since) else ""

    def step(self, current: Current, done: int, say: Say) -> tuple[Current, dict]:
        """Remesh, where it is due; then move along the mean gradient over the views of this step."""
        self.compiled.result()
        phase, state, targets, distance = current
        if done in self.remeshing and done > phase.start:
            mesh = self.remeshed(phase, state, self.remeshing[done], done, say)
            if mesh is not None:
                phase = make_phase(self.config, self.programs[phase.level], mesh, done, phase.level, phase.since)
                state = phase.fresh_state()
        gradient, row = self.gradient(phase, state, targets, done)
        state = phase.update(state, gradient)
        if done + 1 == self.steps or (done + 1) % self.config.report.chamfer == 0:
            distance = row["chamfer"] = self.chamfer(phase, state)
            row["folded"] = self.folded(phase, state, done + 1, say)
        return Current(phase, state, targets, distance), row

    def gradient(self, phase: Phase, state: State, targets, done: int) -> tuple[Float[Array, "V 3"], dict]:
        """Mean gradient and loss over the views of a step, as its row of the metrics has it."""
        vertices, poses = phase.vertices(state), self.poses()
        count, since = self.stages[phase.level].views_per_step, done - phase.since
        views = views_of_step(len(poses), count, since, self.config.seed)
        # Where there is a level to go to, the last step of every round of views is estimated twice: to see the noise.
        twice = phase.level + 1 < len(self.stages) and (since + 1) % -(-len(poses) // count) == 0
        streams = (STEPS, SECOND) if twice else (STEPS,)
        keys = [jax.random.fold_in(jax.random.fold_in(self.key, stream), done) for stream in streams]
        items = [item for key in keys for item in items_of_step(poses, targets, views, key)]
        losses, gradients = [], [jnp.zeros_like(vertices) for _ in streams]
        for number, (loss, part) in enumerate(phase.gradients(vertices, items)):
            check_finite(views[number % len(views)], loss, part, done + 1)
            losses.append(float(loss))
            gradients[number // len(views)] += part / len(views)
        gradient = jnp.asarray(sum(gradients) / len(gradients))
        row = {
            "loss": sum(losses) / len(losses),
            "gradient_norm": float(jnp.linalg.norm(gradient)),
            "vertices": len(vertices),
            "level": phase.level,
        }
        if twice:
            # As the optimiser sees them: preconditioned.
            row["signal_to_noise"] = signal_to_noise(*(phase.from_latent(g) for g in gradients))
        return gradient, row

    def shown(self, current: Current, row: dict) -> dict[str, float]:
        return {"loss": row["loss"], "gradient": row["gradient_norm"], "chamfer": current.distance}

    def after(self, current: Current, done: int, row: dict, say: Say) -> Current:
        """The state, at the next level if the step that wrote `row` found little but noise."""
        ratio = row.get("signal_to_noise", np.inf)
        if ratio >= self.config.optimizer.signal_to_noise or current.phase.level + 1 == len(self.stages):
            return current
        phase, state = self.next_level(current.phase, current.state, done, ratio, say)
        targets = self.coming.result()
        self.look_ahead(phase)
        return current._replace(phase=phase, state=state, targets=targets)

    def next_level(self, phase: Phase, state: State, done: int, ratio: float, say: Say) -> tuple[Phase, State]:
        """What is compiled for the next level; the optimiser goes on unless there is another topology or `lam`."""
        number = phase.level + 1
        stage = self.stages[number]
        say(
            f"after step {done}: signal to noise {ratio:.2g}; "
            f"level {number + 1} of {len(self.stages)}: "
            f"{stage.resolution} pixels, {stage.gradient} spp, {stage.views_per_step} views a step"
        )
        if stage.remeshes:
            mesh = self.remeshed(phase, state, stage, done, say)
            if mesh is not None:
                phase = make_phase(self.config, self.programs[number], mesh, done, number, done)
                return phase, phase.fresh_state()
        if stage.lam != self.stages[phase.level].lam:
            mesh = phase.current_mesh(state)
            phase = make_phase(self.config, self.programs[number], mesh, done, number, done)
            return phase, phase.fresh_state()
        phase = make_phase(self.config, self.programs[number], phase.mesh, phase.start, number, done)
        return phase, state

    def remeshed(self, phase: Phase, state: State, to: Level | Remesh, done: int, say: Say) -> Mesh | None:
        """The current mesh with a new topology. When remeshing fails, a line says so and the result is None."""
        current = phase.current_mesh(state)
        try:
            mesh = mesh_of_writer(lambda: with_new_topology(current, to))
        except ValueError as problem:
            say(f"after step {done}: kept the mesh as it was ({problem})")
            return None
        say(f"after step {done}: remeshed, {len(current.vertices)} -> {len(mesh.vertices)} vertices")
        return mesh

    def saved(self, current: Current, done: int) -> tuple[Place, State]:
        """The mesh with which the phase began, and the state of the optimiser."""
        phase = current.phase
        mesh = np.asarray(phase.mesh.vertices), np.asarray(phase.mesh.faces)
        return Place(done, self.seconds(), phase.level, phase.since, phase.start, *mesh), current.state

    def draw(self, current: Current, done: int, say: Say) -> None:
        phase = current.phase
        shown = views_to_show(self.config.report.views, self.config.cameras.views)
        mesh, key = phase.current_mesh(current.state), jax.random.fold_in(self.key, PICTURES)
        poses, spp = self.poses(), self.config.samples.pictures
        images = np.stack([phase.image(mesh.vertices, poses[view], key, spp) for view in shown])

        def save():
            self.folder.save_grid(done, current.targets[shown], images)
            self.folder.save_mesh(f"{done:05d}", mesh)

        shown_if_possible(done, save, say)

    def finish(self, current: Current, done: int) -> dict:
        """Write the result."""
        before = chamfer(self.initial, self.problem.target, self.config.report.chamfer_samples)
        mesh, after = current.phase.current_mesh(current.state), self.chamfer(current.phase, current.state)
        summary = {
            "iterations": done,
            "seconds": round(self.seconds(), 2),
            "vertices": len(mesh.vertices),
            "chamfer_initial": before,
            "chamfer_final": after,
            "chamfer_ratio": before / after,
            "folded": folded_share(mesh),
            "device": jax.devices()[0].device_kind,
        }
        if self.plan is not None:
            summary["plan"] = self.plan.to_dict()
        self.folder.save_mesh("result", mesh)
        return summary

    def poses(self) -> Float[Array, "N 4 4"]:
        return jnp.asarray(self.problem.views, float)

    def chamfer(self, phase: Phase, state: State) -> float:
        return chamfer(phase.current_mesh(state), self.problem.target, self.config.report.chamfer_samples)

    def folded(self, phase: Phase, state: State, done: int, say: Say) -> float:
        """Share of folded edges. The first time that it is far larger than at the start, a line says so."""
        share = folded_share(phase.current_mesh(state))
        if not self.collapsed and share > self.folded_at_start + COLLAPSED:
            self.collapsed = True
            say(collapse_message(done, share))
        return share
