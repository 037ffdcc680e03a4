"""The loop of `jaxdr reconstruct`: from photographs with known cameras to a mesh with textures and the light."""

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.checkpoint import load_checkpoint, save_checkpoint
from jaxdr.optimize.devices import chosen_devices
from jaxdr.optimize.problem import views_of_step
from jaxdr.optimize.processes import any_process, run_in
from jaxdr.optimize.progress import Interrupted, Interruption, NotFinite, Progress
from jaxdr.optimize.reconstruction.asset import require_xatlas
from jaxdr.optimize.reconstruction.config import ReconstructConfig
from jaxdr.optimize.reconstruction.hull import initial_surface
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.optimize.reconstruction.results import Result, judge, save_asset
from jaxdr.optimize.reconstruction.stage import Stage, first_unknowns, make_stage, next_unknowns
from jaxdr.optimize.reconstruction.unknowns import State, Unknowns
from jaxdr.optimize.remesh import remesh_to, require_gpytoolbox
from jaxdr.views.evaluate import require_skimage
from jaxdr.views.load import load_views
from jaxdr.views.record import Views

# Streams of random numbers under the run's seed.
STEPS, PICTURES = range(2)


def reconstruct(
    config: ReconstructConfig, *, resume: bool = False, overwrite: bool = False, devices: int | None = None
) -> dict:
    """Find mesh, textures and light from photographs, write them, and return what `metrics.json` holds.

    `devices`: how many of JAX's devices share the work, by default all, other processes' as well. Every
    random number derives from the seed and the step, so a run that was interrupted and is resumed ends with the same
    bits. Raises ValueError for photographs or settings that can't be used, an output folder in use or too few devices,
    ImportError before the start where an optional package is missing, `Interrupted` after Ctrl-C (checkpoint, asset and
    light are written), `NotFinite` rather than go on with NaN, and `ProcessLost`.
    """
    require_gpytoolbox()
    require_skimage()
    require_xatlas()
    views = load_views(config.folder, holdout=config.holdout or None)
    run = _Run(config, views, chosen_devices(devices))

    def open_at(path: Path) -> OutputFolder:
        return OutputFolder(path, config).opened(resume, overwrite)

    with run_in(run, Path(config.output), open_at, resume):
        return run.run(resume)


class _Run:
    """One call of `reconstruct`."""

    folder: OutputFolder

    def __init__(self, config: ReconstructConfig, views: Views, devices: list[jax.Device]):
        self.config, self.views, self.devices = config, views, devices
        self.fitted = views.fitted
        self.interruption = Interruption()
        self.key = jax.random.key(config.seed)
        self.clock = time.monotonic()
        kind = config.start.kind
        if kind == "auto":
            kind = "hull" if all(view.alpha is not None for view in self.fitted) else "sphere"
        self.kind = kind
        self.surface, self.pose = initial_surface(self.fitted, kind, config.start.grid)

    def run(self, resume: bool) -> dict:
        total = self.config.steps
        done, stage, state = self.restored() if resume else self.fresh()
        self.folder.start_metrics(done)
        with Progress("reconstruct", total, done) as progress:
            if not all(view.alpha is not None for view in self.fitted):
                progress.say(f"{self.config.folder}: there are no masks; the start is a {self.kind}, the sky is fitted")
            while done < total:
                if done == self.end_of(stage.number):
                    stage, state = self.next_level(stage, state, done, progress)
                state, row, shown = self.step(stage, state, done)
                done += 1
                self.folder.add_metrics({**row, "step": done, "seconds": round(self.seconds(), 2)})
                progress.step(loss=row["loss"], level=float(stage.number + 1))
                if self.due(done, self.config.report.pictures):
                    self.folder.save_picture(done, *shown)
                stop = any_process(self.interruption.requested)
                if self.due(done, self.config.report.checkpoint) or stop:
                    self.save_checkpoint(stage, state, done)
                if stop and done < total:
                    progress.say("writing the asset as it is")
                    save_asset(self.folder, self.result(stage, state), self.config.report.texture)
                    raise Interrupted(f"stopped after step {done}; checkpoint in {self.folder.checkpoint}")
        return self.finish(stage, state)

    def end_of(self, level: int) -> int:
        """Steps done when a level ends."""
        return sum(each.steps for each in self.config.levels[: level + 1])

    def fresh(self) -> tuple[int, Stage, State]:
        """The beginning."""
        level = self.config.levels[0]
        mesh = remesh_to(self.surface, level.vertices).smooth()
        stage = make_stage(self.config, self.fitted, self.pose, 0, 0, mesh, self.devices)
        return 0, stage, stage.fresh(first_unknowns(self.config, self.fitted, self.pose, mesh))

    def restored(self) -> tuple[int, Stage, State]:
        """Steps done, stage and state of the checkpoint; the beginning where there is none yet."""
        if not self.folder.checkpoint.exists():
            return self.fresh()
        saved = load_checkpoint(self.folder.checkpoint, "level", "start", "vertices", "faces")
        if saved.iteration >= self.config.steps and self.folder.finished:
            raise ValueError(f"output {self.folder.path}: this run is finished; there is nothing to resume")
        mesh = Mesh(saved.others["vertices"], saved.others["faces"]).smooth()
        number, start = int(saved.others["level"]), int(saved.others["start"])
        stage = make_stage(self.config, self.fitted, self.pose, number, start, mesh, self.devices)
        rows = self.config.levels[number].sky
        template = Unknowns(
            mesh.vertices,
            jnp.zeros((len(mesh.vertices), 3)),
            jnp.zeros((len(mesh.vertices), 1)),
            jnp.zeros((rows, 2 * (rows - 1), 3)),
            jnp.zeros((len(self.fitted), 3)),
        )
        self.clock -= saved.seconds
        return saved.iteration, stage, saved.state(stage.fresh(template))

    def next_level(self, stage: Stage, state: State, done: int, progress: Progress) -> tuple[Stage, State]:
        """The next level: another mesh and sky, optimisers that begin."""
        number = stage.number + 1
        level = self.config.levels[number]
        current, unknowns = stage.current_mesh(state), stage.unknowns(state)
        mesh, unknowns, problem = next_unknowns(self.config, self.fitted, self.pose, number, current, unknowns)
        if problem:
            progress.say(f"after step {done}: kept the mesh as it was ({problem})")
        progress.say(
            f"after step {done}: level {number + 1} of {len(self.config.levels)}: {len(mesh.vertices)} vertices, "
            f"photographs of {level.resolution} pixels, a sky of {level.sky} rows"
        )
        stage = make_stage(self.config, self.fitted, self.pose, number, done, mesh, self.devices)
        return stage, stage.fresh(unknowns)

    def step(self, stage: Stage, state: State, done: int) -> tuple[State, dict, tuple]:
        """Mean gradient over the views of this step, and the move it causes; what the last of them shows."""
        count = min(self.config.levels[stage.number].views, len(self.fitted))
        chosen = views_of_step(len(self.fitted), count, done - stage.start, self.config.seed)
        key = jax.random.fold_in(jax.random.fold_in(self.key, STEPS), done)
        unknowns, mesh = stage.unknowns(state), stage.mesh
        losses, total = [], None
        items = [
            (stage.photographs[view].camera, stage.photograph(view), jax.random.fold_in(key, slot))
            for slot, view in enumerate(chosen)
        ]
        found = stage.gradient((mesh, unknowns), items)
        for view, (loss, gradient, _) in zip(chosen, found, strict=True):
            finite = [np.isfinite(leaf).all() for leaf in jax.tree.leaves((loss, gradient))]
            if not all(finite):
                self.save_checkpoint(stage, state, done)
                raise NotFinite(
                    f"loss or gradient of {self.fitted[view].path} is not finite in step {done + 1}; the state before "
                    f"that step is in {self.folder.checkpoint}"
                )
            losses.append(float(loss))
            total = gradient if total is None else jax.tree.map(jnp.add, total, gradient)
        mean = jax.tree.map(lambda leaf: leaf / len(chosen), total)
        row = {
            "loss": sum(losses) / len(losses),
            "gradient_norm": float(jnp.linalg.norm(mean.vertices)),
            "vertices": len(mesh.vertices),
            "level": stage.number + 1,
        }
        return stage.update(state, mean), row, (np.asarray(found[-1][2]), stage.photographs[chosen[-1]])

    def result(self, stage: Stage, state: State) -> Result:
        """What was found, in the world of the cameras."""
        return Result.of(stage.mesh, stage.unknowns(state), self.pose)

    def finish(self, stage: Stage, state: State) -> dict:
        """Write the asset, judge it by the held-out photographs, write the report."""
        result = self.result(stage, state)
        save_asset(self.folder, result, self.config.report.texture)
        summary = {
            "steps": self.config.steps,
            "seconds_fitting": round(self.seconds(), 2),
            "vertices": len(result.mesh.vertices),
            "start": self.kind,
            "fitted": len(self.fitted),
            "held_out": len(self.views.held_out),
            "device": jax.devices()[0].device_kind,
        }
        summary |= judge(self.folder, result, self.views, self.config, jax.random.fold_in(self.key, PICTURES))
        summary["seconds"] = round(self.seconds(), 2)
        self.folder.save_summary(summary)
        return summary

    def due(self, done: int, interval: int) -> bool:
        return done % interval == 0 or done == self.config.steps

    def seconds(self) -> float:
        return time.monotonic() - self.clock

    def save_checkpoint(self, stage: Stage, state: State, done: int) -> None:
        vertices, faces = np.asarray(stage.mesh.vertices), np.asarray(stage.mesh.faces)
        save_checkpoint(
            self.folder.checkpoint,
            state,
            done,
            self.seconds(),
            vertices=vertices,
            faces=faces,
            level=stage.number,
            start=stage.start,
        )
