"""The object turning, for people."""

import dataclasses

import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.atomic_file import atomic_path
from jaxdr.images import to_srgb
from jaxdr.integrators import Integrator
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.optimize.reconstruction.upright import circle
from jaxdr.scene.scene import Scene
from jaxdr.views.record import View
from jaxdr.views.rendering import render_views

TURN_SPP, TURN_SIZE = 32, 256  # samples per pixel, pixels along the longer side at most


def save_turntable(
    folder: OutputFolder,
    scene: Scene,
    like: View,
    up: Float[np.ndarray, "3"],
    pose: Pose,
    frames: int,
    integrator: Integrator,
    seed: int,
) -> None:
    """`turntable.gif`: the upright object from all around, at the distance of a photograph, over black."""
    distance = float(np.linalg.norm(like.to_world[:3, 3] - pose.centre))
    scale = min(1.0, TURN_SIZE / max(like.width, like.height))
    width, height = round(like.width * scale), round(like.height * scale)
    blank = np.zeros((height, width, 3), np.float32)  # with alpha, so without the sky behind
    small = dataclasses.replace(like.with_picture(blank, blank[..., 0]), focal=like.focal * scale)
    around = circle(up, pose.centre, distance, frames)
    turns = [dataclasses.replace(small, to_world=turned, centre=(width / 2, height / 2)) for turned in around]
    pictures = render_views(scene, turns, spp=TURN_SPP, seed=seed, integrator=integrator)
    images = [Image.fromarray(to_srgb(picture[..., :3])) for picture in pictures]
    with atomic_path(folder.path / "turntable.gif") as temporary:
        images[0].save(temporary, format="GIF", save_all=True, append_images=images[1:], duration=80, loop=0)
