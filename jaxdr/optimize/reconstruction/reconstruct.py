"""Reconstruction: from photographs with known cameras to a mesh with textures and the light."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.images import to_srgb
from jaxdr.optimize.checkpoint import Checkpoint, Place
from jaxdr.optimize.devices import Device, chosen_devices
from jaxdr.optimize.heartbeat import say, working
from jaxdr.optimize.phase import finite
from jaxdr.optimize.problem import views_of_step
from jaxdr.optimize.progress import NotFinite
from jaxdr.optimize.reconstruction.atlas import require_xatlas
from jaxdr.optimize.reconstruction.automatic_masks.find import Found as FoundMasks
from jaxdr.optimize.reconstruction.automatic_masks.find import find_masks, with_masks
from jaxdr.optimize.reconstruction.carving import HOLLOW, carved, hollow
from jaxdr.optimize.reconstruction.config import ReconstructConfig
from jaxdr.optimize.reconstruction.exposure import first_exposures
from jaxdr.optimize.reconstruction.found_cameras import folder_with_cameras
from jaxdr.optimize.reconstruction.hull import in_own_frame, initial_surface
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.optimize.reconstruction.photo_set import PhotoSet
from jaxdr.optimize.reconstruction.pictures import Cut
from jaxdr.optimize.reconstruction.results import Result, judge, save_asset, save_cameras
from jaxdr.optimize.reconstruction.seen_points import in_frame, of_sparse_points, seen_points, settled
from jaxdr.optimize.reconstruction.stage import Stage, first_unknowns, make_stage, mesh_of_level, next_unknowns
from jaxdr.optimize.reconstruction.stereo import stereo_points
from jaxdr.optimize.reconstruction.unknowns import State, Unknowns
from jaxdr.optimize.remesh import remesh_to, require_gpytoolbox
from jaxdr.optimize.run import Say, Task, run
from jaxdr.optimize.run_files import shown_if_possible
from jaxdr.views.evaluate import decibels, require_skimage
from jaxdr.views.load import load_views
from jaxdr.views.reading import read_ahead
from jaxdr.views.record import View, Views
from jaxdr.views.sparse_points import sparse_points
from jaxdr.views.summary import summary as summary_of

# Streams of random numbers under the run's seed.
STEPS, PICTURES = range(2)
FINER = 2  # photographs are read with so many pixels for one of the finest level, and judged at this size
SETTLED = 0.2  # of the rate of the vertices, where points hold the surface: larger steps tear it up again
STEPS_AHEAD = 2  # steps whose photographs are read while one goes on


def reconstruct(
    config: ReconstructConfig, *, resume: bool = False, overwrite: bool = False, devices: int | None = None
) -> dict:
    """Find mesh, textures and light from photographs, write them, and return what `metrics.json` holds.

    `devices`: how many of JAX's devices share the work, by default all, those of other processes too. Every random
    number derives from the seed and the step. So a run that was interrupted and is resumed ends with the same bits.

    Raises as `jaxdr.optimize.run.run` does (before `Interrupted` asset and light are written, too); ValueError for
    photographs or settings that can't be used, or too few devices; ImportError before the start, where an optional
    package is missing.
    """
    require_gpytoolbox()
    require_skimage()
    require_xatlas()
    longest = FINER * max(level.resolution for level in config.levels)
    keep = config.memory.pictures / 2
    masks = None if config.masks in ("auto", "none") else config.masks
    folder = folder_with_cameras(Path(config.folder), Path(config.output), config.seed, overwrite, say)
    with working(f"{config.folder}: reading photographs"):
        views = load_views(folder, holdout=config.holdout or None, keep=keep, longest=longest, masks=masks)
    say(f"{config.folder}: {summary_of(views)}")
    found: FoundMasks | None = None
    problem = ""
    if config.masks == "auto" and not views.masked:
        try:
            with working(f"{config.folder}: looking for the object"):
                found = find_masks(views, config.seed, say)
        except ValueError as fault:
            problem = str(fault)
            say(problem)
        else:
            views = with_masks(views, found)
    with working(f"{config.folder}: looking for the first surface"):
        task = ReconstructionTask(config, views, chosen_devices(devices), found, problem)
    return run(task, resume, overwrite)


def _check(view: View) -> None:
    view.picture.read()


class Current(NamedTuple):
    """A level, what a step changes, and what the last view of the last step showed, with its photograph."""

    stage: Stage
    state: State
    picture: tuple[Float[np.ndarray, "H W 4"], Cut] | None = None


class ReconstructionTask(Task[Current]):
    """A call of `reconstruct`."""

    name = "reconstruct"

    def __init__(
        self,
        config: ReconstructConfig,
        views: Views,
        devices: list[Device],
        masks: FoundMasks | None = None,
        problem: str = "",
    ):
        super().__init__(config, config.steps, devices)
        self.masks, self.problem = masks, problem
        self.folder, self.views, self.fitted = OutputFolder(config, views), views, views.fitted
        keep = int(config.memory.pictures / 2 * 2**30)
        self.photos = PhotoSet(self.fitted, [level.resolution for level in config.levels], keep)
        for _ in read_ahead(_check, views.held_out):  # an error now, not when all steps are done
            pass
        kind = config.start.kind
        if kind == "auto":
            kind = "hull" if self.photos.masked else "sphere"
        self.kind = kind
        if masks is not None and config.start.kind == "auto":
            self.kind = "agreement of automatic masks"
            self.surface, self.pose = in_own_frame(
                *(np.asarray(part) for part in (masks.solid.vertices, masks.solid.faces))
            )
        else:
            self.surface, self.pose = initial_surface(self.fitted, kind, config.start.grid, keep)
        self.photos.pose = self.pose
        if self.photos.masked:
            self._see()
        self.config = self._chosen()
        self.steps = self.config.steps

    def _see(self) -> None:
        """Look for points of the object that photographs saw, sparse ones of a COLMAP model and those of stereo.

        Where many of them are deep under the first surface, it is carved, and the points hold it. Else outlines tell
        more.
        """
        found = [of_sparse_points(self.views, sparse_points(self.views))]
        if self.config.start.stereo:
            radius = self.pose.scale * float(np.linalg.norm(np.asarray(self.surface.vertices), axis=1).max())
            found.append(stereo_points(self.fitted, self.pose, radius))
        rays = in_frame(found, self.pose)
        share = hollow(self.surface, *rays)
        counts = " + ".join(f"{len(points):,}" for _, points in found)
        say(
            f"{self.config.folder}: points of the object that photographs saw (sparse + stereo): {counts}; {share:.0%} "
            f"are deep under the first surface, {'so it is carved' if share > HOLLOW else 'which is good'}"
        )
        if share > HOLLOW:
            self.photos.seen = seen_points(*rays)
            self.surface = Mesh(*carved(self.surface, *rays))

    def _chosen(self) -> ReconstructConfig:
        """The config with what is unknown in place of "auto". Photographs get their first exposures.

        Where points hold the surface, steps are small, and the coarsest level, for a rough surface, is left out.
        """
        config = self.config
        asked = tuple(name for name in config.unknown if name != "auto")
        if "exposure" in asked or "auto" in config.unknown:
            mesh = self.surface if self.photos.masked else None
            coarse = self.photos.at(min(self.photos.resolutions))
            self.photos.exposure, differ = first_exposures(mesh, coarse)
            if differ:
                say(f"{config.folder}: {differ}; exposures are fitted")
                asked = tuple(dict.fromkeys((*asked, "exposure")))
        config = dataclasses.replace(config, unknown=asked)
        if self.photos.seen is None:
            return config
        rates = dataclasses.replace(config.rates, vertices=SETTLED * config.rates.vertices)
        return dataclasses.replace(config, rates=rates, levels=config.levels[1:] or config.levels)

    def begin(self, saved: Checkpoint | None) -> Current:
        """The first level, or that of the checkpoint."""
        self.folder.save_masks(self.views.views)
        stage, state = self.fresh() if saved is None else self.restored(saved)
        if not self.photos.masked:
            say(f"{self.config.folder}: there are no masks; the start is a {self.kind}, the sky is fitted")
        return Current(stage, state)

    def coming_views(self, stage: Stage, done: int) -> list[int]:
        """Numbers of the views of the step after `done` ones, and of the next few steps of the level."""
        steps = range(done, min(done + 1 + STEPS_AHEAD, self.end_of(stage.number)))
        return [view for step in steps for view in self.views_of(stage, step)]

    def views_of(self, stage: Stage, done: int) -> list[int]:
        """Numbers of the views of one step."""
        size = min(self.config.levels[stage.number].views, len(self.fitted))
        return views_of_step(len(self.fitted), size, done - stage.start, self.config.seed)

    def end_of(self, level: int) -> int:
        """The number of steps that are done when a level ends."""
        return sum(each.steps for each in self.config.levels[: level + 1])

    def fresh(self) -> tuple[Stage, State]:
        level = self.config.levels[0]
        mesh = mesh_of_level(level, self.first_mesh)
        unknowns = first_unknowns(self.config, self.photos, mesh)
        stage = make_stage(self.config, self.photos, 0, 0, mesh, self.devices)
        return stage, stage.fresh(unknowns)

    def first_mesh(self) -> Mesh:
        """The first surface as the first level needs it, near the points of the object that photographs saw."""
        mesh = remesh_to(self.surface, self.config.levels[0].vertices)
        return mesh if self.photos.seen is None else settled(mesh, self.photos.seen)

    def restored(self, saved: Checkpoint) -> tuple[Stage, State]:
        """Stage and state of a checkpoint."""
        place = saved.place
        level = self.config.levels[place.level]
        mesh = mesh_of_level(level, lambda: Mesh(place.vertices, place.faces))
        stage = make_stage(self.config, self.photos, place.level, place.start, mesh, self.devices)
        rows, points = level.sky, (level.texture, level.texture) if level.texture else (len(mesh.vertices),)
        template = Unknowns(
            mesh.vertices,
            jnp.zeros((*points, 3)),
            jnp.zeros((len(mesh.vertices), 1)),
            jnp.zeros((rows, 2 * (rows - 1), 3)),
            jnp.zeros((len(self.fitted), 3)),
            jnp.zeros((len(self.fitted), 6)),
        )
        return stage, saved.state(stage.fresh(template))

    def next_level(self, stage: Stage, state: State, done: int, say: Say) -> tuple[Stage, State]:
        """The next level, with another mesh and sky, and with fresh optimisers."""
        number = stage.number + 1
        level = self.config.levels[number]
        current, unknowns = stage.current_mesh(state), stage.unknowns(state)
        mesh, unknowns, problem = next_unknowns(self.config, self.photos, number, current, unknowns)
        if problem:
            say(f"after step {done}: kept the mesh as it was ({problem})")
        say(
            f"after step {done}: level {number + 1} of {len(self.config.levels)}: {len(mesh.vertices)} vertices, "
            f"photographs of {level.resolution} pixels, a sky of {level.sky} rows"
        )
        stage = make_stage(self.config, self.photos, number, done, mesh, self.devices)
        return stage, stage.fresh(unknowns)

    def preparing(self, current: Current, done: int) -> str:
        """A level has programs of its own."""
        number, count = current.stage.number + (done == self.end_of(current.stage.number)), len(self.config.levels)
        return f"compiling level {number + 1} of {count}" if done == self.end_of(number - 1) else ""

    def step(self, current: Current, done: int, say: Say) -> tuple[Current, dict]:
        """Go on to the next level, where it is time; then move along the mean gradient over the views of this step."""
        stage, state, _ = current
        if done == self.end_of(stage.number):
            stage, state = self.next_level(stage, state, done, say)
        stage.photographs.expect(self.coming_views(stage, done))
        chosen = self.views_of(stage, done)
        key = jax.random.fold_in(jax.random.fold_in(self.key, STEPS), done)
        unknowns, mesh = stage.unknowns(state), stage.mesh
        losses, total = [], None
        items = [
            (stage.photographs[view].camera, stage.photograph(view), jax.random.fold_in(key, slot))
            for slot, view in enumerate(chosen)
        ]
        found = stage.gradient((mesh, unknowns), items)
        for view, (loss, gradient, _) in zip(chosen, found, strict=True):
            if not finite((loss, gradient)):
                raise NotFinite(f"loss or gradient of {self.fitted[view].path} is not finite in step {done + 1}")
            losses.append(float(loss))
            total = gradient if total is None else jax.tree.map(jnp.add, total, gradient)
        mean = jax.tree.map(lambda leaf: leaf / len(chosen), total)
        row = {
            "loss": sum(losses) / len(losses),
            "gradient_norm": float(jnp.linalg.norm(mean.vertices)),
            "vertices": len(mesh.vertices),
            "level": stage.number + 1,
        }
        picture = np.asarray(found[-1][2]), stage.photographs[chosen[-1]]
        return Current(stage, stage.update(state, mean), picture), row

    def shown(self, current: Current, row: dict) -> dict[str, float]:
        assert current.picture is not None  # a step is done
        rendering, photograph = current.picture
        difference = to_srgb(rendering[..., :3]).astype(float) - to_srgb(photograph.color)
        return {"loss": row["loss"], "level": float(row["level"]), "psnr": decibels((difference / 255) ** 2)}

    def saved(self, current: Current, done: int) -> tuple[Place, State]:
        """The mesh with which the level began, and the state of the optimisers."""
        stage = current.stage
        mesh = np.asarray(stage.mesh.vertices), np.asarray(stage.mesh.faces)
        return Place(done, self.seconds(), stage.number, stage.start, stage.start, *mesh), current.state

    def draw(self, current: Current, done: int, say: Say) -> None:
        """Draw what the last step saw; before the first step there is nothing."""
        if current.picture is not None:
            shown_if_possible(done, partial(self.folder.save_picture, done, *current.picture), say)

    def save_asset(self, current: Current) -> Result:
        """Write the asset and the light as they are; returns what was found."""
        unknowns = current.stage.unknowns(current.state)
        result = Result.of(current.stage.mesh, unknowns, self.pose, self.views, self.config.asset)
        save_asset(self.folder, result, self.config.report.texture)
        return result

    def stopped(self, current: Current, say: Say) -> None:
        """Write the asset as it is."""
        say("writing the asset as it is")
        result = self.save_asset(current)
        save_cameras(self.folder, result.views(self.views, self.config), result.frame)

    def finish(self, current: Current, done: int) -> dict:
        """Write the asset, judge it by the held-out photographs, write the report."""
        result = self.save_asset(current)
        summary = {
            "steps": done,
            "seconds_fitting": round(self.seconds(), 2),
            "vertices": len(result.mesh.vertices),
            "start": self.kind,
            "fitted": len(self.fitted),
            "held_out": len(self.views.held_out),
            "device": jax.devices()[0].device_kind,
        }
        if self.masks is not None:
            summary["masks"] = self.masks.to_dict()
        if self.problem:
            summary["problem"] = self.problem
        summary |= judge(self.folder, result, self.views, self.config, jax.random.fold_in(self.key, PICTURES))
        summary["seconds"] = round(self.seconds(), 2)
        return summary
