"""The result of a reconstruction: asset, light, cameras, and how well it agrees with held-out photographs."""

import dataclasses
import json
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.progress import Progress
from jaxdr.optimize.reconstruction.asset import write_glb
from jaxdr.optimize.reconstruction.asset_frame import AssetFrame
from jaxdr.optimize.reconstruction.cameras import sizes, with_corrections
from jaxdr.optimize.reconstruction.config import Asset, ReconstructConfig
from jaxdr.optimize.reconstruction.evenly import evenly
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.optimize.reconstruction.sky import resampled
from jaxdr.optimize.reconstruction.turntable import save_turntable
from jaxdr.optimize.reconstruction.unknowns import Unknowns, reflectance, roughness_of, scene_of
from jaxdr.scene.scene import Scene
from jaxdr.views.evaluate import Evaluation, channel_scale, score_picture
from jaxdr.views.layouts.transforms import FROM_OPENGL, lens_entries
from jaxdr.views.record import View, Views
from jaxdr.views.rendering import render_views

PATHS, LEAST = 1 << 24, 16  # most paths of a picture of the result, and fewest samples per pixel
COMPARED = 24  # most views whose photograph and rendering are kept side by side
FINER = 4  # the light is written with so many texels for one, interpolated as it was used


class Result(NamedTuple):
    """What was found: `mesh` in the world of the cameras, `unknowns` with its vertices, `pose` of the object, and the
    `frame` of the asset."""

    mesh: Mesh
    unknowns: Unknowns
    pose: Pose
    frame: AssetFrame

    @classmethod
    def of(cls, mesh: Mesh, unknowns: Unknowns, pose: Pose, views: Views, asset: Asset) -> "Result":
        """From the frame of the object to the world of the cameras."""
        vertices = unknowns.vertices * pose.scale + jnp.asarray(pose.centre, unknowns.vertices.dtype)
        frame = AssetFrame.of(np.asarray(vertices, float), views.views, asset)
        return cls(mesh.with_vertices(vertices), unknowns._replace(vertices=vertices), pose, frame)

    def views(self, views: Views, config: ReconstructConfig) -> Views:
        """The photographs with the cameras that were found."""
        if "cameras" not in config.unknown:
            return views
        return with_corrections(views, self.unknowns.cameras, self.pose.scale)

    def scene(self, view: View) -> Scene:
        """The scene with the camera of a photograph."""
        return scene_of(self.mesh, self.unknowns, view.camera)


def save_asset(folder: OutputFolder, result: Result, size: int) -> None:
    """`asset.glb` and the light, in the frame of the asset."""
    mesh = result.mesh.with_vertices(jnp.asarray(result.frame.points(np.asarray(result.mesh.vertices, float)), float))
    albedo = np.asarray(reflectance(result.unknowns.albedo), float)
    roughness = np.asarray(roughness_of(result.unknowns.roughness), float)
    write_glb(folder.path / "asset.glb", mesh, albedo, roughness, size)
    light = np.asarray(result.unknowns.light, float)
    folder.save_light(result.frame.light(resampled(np.exp(light), FINER * (len(light) - 1) + 1)))


def judge(folder: OutputFolder, result: Result, views: Views, config: ReconstructConfig, key: PRNGKeyArray) -> dict:
    """Renderings of the held-out views, their scores, and the turntable; returns the scores.

    `with_gains`: PSNR if each rendering has one factor a channel, as for photographs of unknown exposure.

    Without held-out photographs it shows those that were fitted, and says so.
    """
    found: dict = {}
    if "cameras" in config.unknown:
        found["cameras"] = sizes(result.unknowns.cameras, result.pose.scale)
    views = result.views(views, config)
    save_cameras(folder, views, result.frame)
    shown = views.held_out or views.fitted
    tracer = dataclasses.replace(config.integrator.build(), boundary=None)
    seed = int(jax.random.randint(key, (), 0, 2**31 - 1))
    scene = result.scene(shown[0])
    spp = max(LEAST, min(config.samples.pictures, PATHS // (shown[0].width * shown[0].height)))
    side_by_side = set(evenly(len(shown), COMPARED).tolist())
    scores, matched = [], []
    with Progress("render views", len(shown)) as progress:
        progress.preparing("compiling")
        for i, view in enumerate(shown):  # one by one: there may be thousands
            (picture,) = render_views(scene, [view], spp=spp, seed=(seed + i) % 2**31, integrator=tracer)
            if views.held_out:
                folder.save_test(view.name, picture, view.masked)
            scores.append(score_picture(picture, view))
            matched.append(score_picture(picture, view, channel_scale([picture], [view])))
            if i in side_by_side:
                folder.save_compared(view, picture)
            progress.step()
    evaluation = Evaluation(tuple(scores))
    kind = "held out" if views.held_out else "fitted"
    if config.report.turntable:
        up = result.frame.rotation[1]
        save_turntable(folder, scene, views.views[0], up, result.pose, config.report.turntable, tracer, seed)
    gains = {key: value for key, value in Evaluation(tuple(matched)).to_dict().items() if key.startswith("psnr")}
    found["to_asset"] = result.frame.matrix.tolist()
    return {"judged_by": kind, "samples": spp, **found, **evaluation.to_dict(), "with_gains": gains}


def save_cameras(folder: OutputFolder, views: Views, frame: AssetFrame) -> None:
    """`transforms.json`: the cameras of all photographs in the frame of the asset, as instant-ngp has them.

    `to_asset` is the frame: it takes points of the world of the given cameras there.
    """
    frames = [
        {
            "file_path": str(view.path.resolve()),
            "transform_matrix": (view.to_world @ FROM_OPENGL).tolist(),
            "held_out": view.held_out,
        }
        | lens_entries(view.lens)
        | ({"mask_path": str(mask.resolve())} if (mask := folder.mask(view)) else {})
        for view in frame.views(views).views
    ]
    text = json.dumps({"to_asset": frame.matrix.tolist(), "frames": frames}, indent=1)
    folder.write_text("transforms.json", text + "\n")
