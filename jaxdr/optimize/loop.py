"""The optimisation loop: from rendered target views and a sphere to a mesh."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.chamfer import chamfer
from jaxdr.optimize.checkpoint import Place
from jaxdr.optimize.config import Level, OptimizeConfig, Remesh
from jaxdr.optimize.devices import Device, chosen_devices
from jaxdr.optimize.field_aligned import remesh_field_aligned, require_pyinstantmeshes
from jaxdr.optimize.folds import COLLAPSED, collapse_message, folded_share
from jaxdr.optimize.output import RunFolder, views_to_show
from jaxdr.optimize.phase import Phase, Programs, State, make_phase, make_programs
from jaxdr.optimize.planned import planned
from jaxdr.optimize.problem import OBJECT, build_problem, views_of_step
from jaxdr.optimize.processes import any_process, mesh_of_writer, run_in
from jaxdr.optimize.progress import Interrupted, Interruption, NotFinite, Progress
from jaxdr.optimize.remesh import remesh, remesh_to, require_gpytoolbox
from jaxdr.optimize.run_files import shown_if_possible
from jaxdr.optimize.signal import signal_to_noise
from jaxdr.optimize.targets import rendered, target_views
from jaxdr.plan.report import Plan

# Streams of random numbers under the run's seed.
TARGETS, STEPS, PICTURES, PLAN, SECOND = range(5)  # SECOND: of a step that is estimated twice


def optimize(
    config: OptimizeConfig, *, resume: bool = False, overwrite: bool = False, devices: int | None = None
) -> dict:
    """Run a config to its end and return the summary that `metrics.json` holds.

    `devices`: how many of JAX's devices share the work, by default all, those of other processes too. Every random
    number derives from the seed and the iteration. So a run that was interrupted and is resumed ends with the same
    bits.

    - Raises ValueError for a config that can't be run, an output folder in use, or too few devices.
    - Raises ImportError before the start, where remeshing is asked for and not installed.
    - Raises `Interrupted` after Ctrl-C or SIGTERM, and `Stopped` where a checkpoint or result can't be written.
    - Raises `NotFinite` rather than go on with NaN, and `ProcessLost`.
    """
    run = _Run(config, chosen_devices(devices))
    with run_in(run, resume, overwrite):
        try:
            return run.run(resume)
        finally:
            run.beside.shutdown(cancel_futures=True)


def is_field_aligned(to: Level | Remesh) -> bool:
    return isinstance(to, Remesh) and to.field_aligned


def with_new_topology(mesh: Mesh, to: Level | Remesh) -> Mesh:
    """The same surface as `to` asks for it. Raises ValueError where remeshing fails."""
    if is_field_aligned(to):
        return remesh_field_aligned(mesh, to.vertices)
    return remesh_to(mesh, to.vertices) if to.vertices else remesh(mesh, to.edge_length)


class _Run:
    """One call of `optimize`."""

    def __init__(self, config: OptimizeConfig, devices: list[Device]):
        self.config, self.devices = config, devices
        self.problem = build_problem(config)
        self.initial = self.problem.scene.shapes[OBJECT].mesh
        options = config.optimizer
        self.remeshing = {i: remesh for remesh in options.remesh for i in remesh.steps(options.iterations)}
        self.stages = config.stages()
        sizes = [*self.remeshing.values(), *(stage for stage in self.stages if stage.remeshes)]
        if any(is_field_aligned(to) for to in sizes):
            require_pyinstantmeshes()  # now, not after an hour
        if not all(is_field_aligned(to) for to in sizes):
            require_gpytoolbox()
        self.folder = RunFolder(config)
        self.plan: Plan | None = None
        self.programs: list[Programs] = []  # one for each level, made once the integrator is known
        self.beside = ThreadPoolExecutor(1, "jaxdr ahead")
        self.coming: Future | None = None
        self.rendered: dict[int, np.ndarray] = {}  # target views by their resolution
        self.interruption = Interruption()
        self.collapsed = False
        self.folded_at_start = folded_share(self.initial)
        self.key = jax.random.key(config.seed)
        self.clock = time.monotonic()

    def run(self, resume: bool) -> dict:
        total = self.config.optimizer.iterations
        self.plan_integrator(resume)
        self.programs = make_programs(self.config, self.problem, self.devices)
        iteration, phase, state = self.restored() if resume else self.fresh()
        self.folder.start_metrics(iteration)
        compiled = self.ahead(self.compile, phase.level, phase.mesh)
        targets = self.targets(phase.level, resume)
        self.look_ahead(phase, resume)
        if iteration == 0:
            self.save_checkpoint(phase, state, 0)  # from here on a run without a checkpoint has lost it
            self.folder.save_mesh("target", self.problem.target)
            self.save_pictures(phase, state, targets, 0)
        compiled.result()

        with Progress("optimise", total, iteration) as progress:
            distance = self.chamfer(phase, state)
            while iteration < total:
                if iteration in self.remeshing and iteration > phase.start:
                    mesh = self.remeshed(phase, state, self.remeshing[iteration], iteration, progress)
                    if mesh is not None:
                        programs = self.programs[phase.level]
                        phase = make_phase(self.config, programs, mesh, iteration, phase.level, phase.since)
                        state = phase.fresh_state()
                state, row = self.step(phase, state, targets, iteration)
                iteration += 1
                if self.due(iteration, self.config.report.chamfer):
                    distance = row["chamfer"] = self.chamfer(phase, state)
                    row["folded"] = self.folded(phase, state, iteration, progress)
                self.folder.add_metrics({**row, "iteration": iteration, "seconds": round(self.seconds(), 2)})
                progress.step(loss=row["loss"], gradient=row["gradient_norm"], chamfer=distance)
                if iteration < total and self.finer(phase, row):
                    phase, state = self.next_level(phase, state, iteration, row, progress)
                    targets = self.coming.result()
                    self.look_ahead(phase, resume)
                if self.due(iteration, self.config.report.pictures):
                    self.save_pictures(phase, state, targets, iteration)
                stop = any_process(self.interruption.requested)
                if self.due(iteration, self.config.report.checkpoint) or stop:
                    self.save_checkpoint(phase, state, iteration)
                if stop and iteration < total:
                    raise Interrupted(f"stopped after step {iteration}; checkpoint in {self.folder.checkpoint}")
        return self.finish(phase, state)

    def plan_integrator(self, resume: bool) -> None:
        """Where the config leaves it to a plan: of derivatives of the first view by the initial vertices."""
        options, scene, spp = self.config.integrator, self.problem.scene, self.config.samples.gradient
        key = jax.random.fold_in(self.key, PLAN)
        self.plan = planned(options, scene, [f"{OBJECT}.vertices"], spp, key, self.folder, resume)
        if self.plan is not None:
            self.problem = self.problem._replace(integrator=self.plan.integrator)

    def fresh(self) -> tuple[int, Phase, State]:
        phase = make_phase(self.config, self.programs[0], self.initial, 0)
        return 0, phase, phase.fresh_state()

    def restored(self) -> tuple[int, Phase, State]:
        """Iteration, phase and state of the checkpoint; the beginning when the run stopped before its first one."""
        iteration, phase, state = self.fresh()
        saved = self.folder.load_checkpoint()
        if saved is None:
            return iteration, phase, state
        place, mesh = saved.place, self.initial
        if place.start > 0:
            mesh = Mesh(place.vertices, place.faces)
            mesh = mesh.smooth() if self.config.initial.shading == "smooth" else mesh
        phase = make_phase(self.config, self.programs[place.level], mesh, place.start, place.level, place.since)
        self.clock -= place.seconds
        return place.step, phase, saved.state(phase.fresh_state())

    def targets(self, level: int, resume: bool, quiet: bool = False) -> Float[np.ndarray, "N H W 3"]:
        """Target views of a level: rendered, or read back when a run is resumed."""
        mesh, spp, last = self.problem.target, self.config.samples.target, level + 1 == len(self.stages)
        image, resolution = self.programs[level].image, self.stages[level].resolution
        key = jax.random.fold_in(self.key, TARGETS)
        images = self.rendered.get(resolution)
        if images is None:
            images = rendered(lambda *view: image(mesh, *view, spp), self.poses(), key, self.interruption, quiet)
        self.rendered[resolution] = target_views(self.folder, resume, images, None if last else level)
        return self.rendered[resolution]

    def look_ahead(self, phase: Phase, resume: bool) -> None:
        """Prepare the level after that of `phase`, if there is one, in a thread beside what goes on."""
        if phase.level + 1 < len(self.stages):
            self.coming = self.ahead(self.prepared, phase.level + 1, phase.mesh, resume)

    def ahead(self, function: Callable, *arguments) -> Future:
        """Call a function in the thread beside, one after the other, with the precision that this thread has."""
        x64 = jax.dtypes.canonicalize_dtype(float) == np.float64

        def called():
            with jax.enable_x64(x64):
                return function(*arguments)

        return self.beside.submit(called)

    def prepared(self, level: int, mesh: Mesh, resume: bool) -> Float[np.ndarray, "N H W 3"]:
        """Target views of a level; its gradient is compiled where one knows already how many faces it will have."""
        stage = self.stages[level]
        targets = self.targets(level, resume, quiet=True)
        if stage.edge_length > 0 or (self.programs[level] is self.programs[level - 1] and not stage.vertices):
            return targets
        try:
            mesh = remesh_to(mesh, stage.vertices) if stage.vertices else mesh
        except ValueError:  # the mesh as it will be then is another one: it may do
            return targets
        self.compile(level, mesh)
        return targets

    def compile(self, level: int, mesh: Mesh) -> None:
        """Have the gradient of a level compiled for meshes like this one: JAX does when it is called."""
        resolution = self.stages[level].resolution
        target = jnp.zeros((resolution, resolution, 3), mesh.vertices.dtype)
        self.programs[level].gradient.compile(mesh, (self.poses()[0], target, self.key))

    def step(self, phase: Phase, state: State, targets, iteration: int) -> tuple[State, dict]:
        """Mean loss and gradient over the views of this step, and the move they cause."""
        vertices, poses = phase.vertices(state), self.poses()
        count, done = self.stages[phase.level].views_per_step, iteration - phase.since
        views = views_of_step(len(poses), count, done, self.config.seed)
        # Where there is a level to go to, the last step of every round of views is estimated twice: to see the noise.
        twice = phase.level + 1 < len(self.stages) and (done + 1) % -(-len(poses) // count) == 0
        streams = (STEPS, SECOND) if twice else (STEPS,)
        keys = [jax.random.fold_in(jax.random.fold_in(self.key, stream), iteration) for stream in streams]
        items = [
            (poses[view], jnp.asarray(targets[view]), jax.random.fold_in(key, slot))
            for key in keys
            for slot, view in enumerate(views)
        ]
        losses, gradients = [], [jnp.zeros_like(vertices) for _ in streams]
        for number, (loss, part) in enumerate(phase.gradients(vertices, items)):
            view = views[number % len(views)]
            wrong = [n for n, v in (("loss", loss), ("gradient", part)) if not np.isfinite(v).all()]
            if wrong:
                self.save_checkpoint(phase, state, iteration)
                raise NotFinite(
                    f"the {wrong[0]} of view {view} is not finite in step {iteration + 1}; "
                    f"the state before that step is in {self.folder.checkpoint}"
                )
            losses.append(float(loss))
            gradients[number // len(views)] += part / len(views)
        gradient = sum(gradients) / len(gradients)
        row = {
            "loss": sum(losses) / len(losses),
            "gradient_norm": float(jnp.linalg.norm(gradient)),
            "vertices": len(vertices),
            "level": phase.level,
        }
        if twice:
            # As the optimiser sees them: preconditioned.
            row["signal_to_noise"] = signal_to_noise(*(phase.steps.from_latent(g) for g in gradients))
        return phase.update(state, gradient), row

    def finer(self, phase: Phase, row: dict) -> bool:
        """Whether there is another level, and the step that wrote `row` found little but noise in this one."""
        ratio = row.get("signal_to_noise", np.inf)
        return ratio < self.config.optimizer.signal_to_noise and phase.level + 1 < len(self.stages)

    def next_level(
        self, phase: Phase, state: State, iteration: int, row: dict, progress: Progress
    ) -> tuple[Phase, State]:
        """What is compiled for the next level; the optimiser goes on unless there is another topology or `lam`."""
        number = phase.level + 1
        stage = self.stages[number]
        progress.say(
            f"after step {iteration}: signal to noise {row['signal_to_noise']:.2g}; "
            f"level {number + 1} of {len(self.stages)}: "
            f"{stage.resolution} pixels, {stage.gradient} spp, {stage.views_per_step} views a step"
        )
        if stage.remeshes:
            mesh = self.remeshed(phase, state, stage, iteration, progress)
            if mesh is not None:
                phase = make_phase(self.config, self.programs[number], mesh, iteration, number, iteration)
                return phase, phase.fresh_state()
        if stage.lam != self.stages[phase.level].lam:
            mesh = phase.current_mesh(state)
            phase = make_phase(self.config, self.programs[number], mesh, iteration, number, iteration)
            return phase, phase.fresh_state()
        phase = make_phase(self.config, self.programs[number], phase.mesh, phase.start, number, iteration)
        return phase, state

    def remeshed(
        self, phase: Phase, state: State, to: Level | Remesh, iteration: int, progress: Progress
    ) -> Mesh | None:
        """The current mesh with a new topology; None, said aloud, when remeshing fails."""
        current = phase.current_mesh(state)
        try:
            mesh = mesh_of_writer(lambda: with_new_topology(current, to))
        except ValueError as problem:
            progress.say(f"after step {iteration}: kept the mesh as it was ({problem})")
            return None
        progress.say(f"after step {iteration}: remeshed, {len(current.vertices)} -> {len(mesh.vertices)} vertices")
        return mesh

    def finish(self, phase: Phase, state: State) -> dict:
        """Write result and summary."""
        before = chamfer(self.initial, self.problem.target, self.config.report.chamfer_samples)
        after = self.chamfer(phase, state)
        summary = {
            "iterations": self.config.optimizer.iterations,
            "seconds": round(self.seconds(), 2),
            "vertices": len(phase.mesh.vertices),
            "chamfer_initial": before,
            "chamfer_final": after,
            "chamfer_ratio": before / after,
            "folded": folded_share(phase.current_mesh(state)),
            "device": jax.devices()[0].device_kind,
        }
        if self.plan is not None:
            summary["plan"] = self.plan.to_dict()
        self.folder.save_mesh("result", phase.current_mesh(state))
        self.folder.save_summary(summary)
        return summary

    def due(self, iteration: int, interval: int) -> bool:
        return iteration % interval == 0 or iteration == self.config.optimizer.iterations

    def seconds(self) -> float:
        return time.monotonic() - self.clock

    def poses(self) -> Float[jax.Array, "N 4 4"]:
        return jnp.asarray(self.problem.views, float)

    def chamfer(self, phase: Phase, state: State) -> float:
        return chamfer(phase.current_mesh(state), self.problem.target, self.config.report.chamfer_samples)

    def folded(self, phase: Phase, state: State, iteration: int, progress: Progress) -> float:
        """Share of folded edges; the first time that there are many more than at the start it is said aloud."""
        share = folded_share(phase.current_mesh(state))
        if not self.collapsed and share > self.folded_at_start + COLLAPSED:
            self.collapsed = True
            progress.say(collapse_message(iteration, share))
        return share

    def save_pictures(self, phase: Phase, state: State, targets, iteration: int) -> None:
        shown = views_to_show(self.config.report.views, self.config.cameras.views)
        mesh, key = phase.current_mesh(state), jax.random.fold_in(self.key, PICTURES)
        poses, spp = self.poses(), self.config.samples.pictures
        images = np.stack([phase.image(mesh.vertices, poses[view], key, spp) for view in shown])

        def save():
            self.folder.save_grid(iteration, targets[shown], images)
            self.folder.save_mesh(f"{iteration:05d}", mesh)

        shown_if_possible(iteration, save)

    def save_checkpoint(self, phase: Phase, state: State, iteration: int) -> None:
        mesh = np.asarray(phase.mesh.vertices), np.asarray(phase.mesh.faces)
        place = Place(iteration, self.seconds(), phase.level, phase.since, phase.start, *mesh)
        self.folder.save_checkpoint(place, state)
