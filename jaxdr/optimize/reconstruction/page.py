"""For people: a page with photographs, renderings and errors side by side, and the object turning."""

import base64
import dataclasses
import html
import io
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from jaxdr.atomic_file import atomic_path
from jaxdr.images import diverging, to_srgb
from jaxdr.integrators import Integrator
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.optimize.reconstruction.upright import circle
from jaxdr.scene.scene import Scene
from jaxdr.views.evaluate import Evaluation, Score
from jaxdr.views.record import View
from jaxdr.views.rendering import render_views
from jaxdr.web_page import content_policy

FIGURES = (
    *(("psnr", "PSNR (dB)"), ("psnr_inside", "PSNR inside of the mask (dB)"), ("ssim", "SSIM")),
    ("iou", "overlap of masks"),
)
DIFFERENCE = 0.25  # of encoded grey values: the ends of the colours of errors
TURN_SPP, TURN_SIZE = 32, 256  # samples per pixel, pixels along the longer side at most
STYLE = (
    "body{font:15px sans-serif;margin:2em;background:#fff;color:#222}td,th{padding:4px 8px;text-align:left}"
    "img{image-rendering:pixelated;width:256px}"
)


def page_row(view: View, picture: Float[np.ndarray, "H W 4"], score: Score) -> str:
    """A row of the page: photograph, rendering, difference and figures of a view."""
    photograph, rendering = to_srgb(view.over_black), to_srgb(picture[..., :3])
    difference = (rendering.astype(float) - photograph).mean(-1) / 255
    cells = "".join(f"<td>{_image(x)}</td>" for x in (photograph, rendering, diverging(difference, DIFFERENCE)))
    overlap = "" if score.iou is None else f"<br>overlap {score.iou:.4f}"
    return f"<tr>{cells}<td>{html.escape(view.name)}<br>{score.psnr:.2f} dB<br>SSIM {score.ssim:.4f}{overlap}</td></tr>"


def report_page(rows: Sequence[str], scores: Evaluation, kind: str, turntable: bool, folder: OutputFolder) -> str:
    """HTML that needs no other file: figures, and the rows of all views or of some spread over them."""
    summary = scores.to_dict()
    figures = "".join(
        f"<tr><td>{name}</td><td>{summary[key]['mean']:.4g}</td><td>{summary[key]['worst']:.4g}</td></tr>"
        for key, name in FIGURES
        if key in summary
    )
    some = "" if len(rows) == len(scores.scores) else f" {len(rows)} of {len(scores.scores)} views are shown."
    turning = ""
    if turntable:
        data = base64.b64encode((folder.path / "turntable.gif").read_bytes()).decode()
        turning = f'<p><img src="data:image/gif;base64,{data}" alt="the object turning"></p>'
    title = html.escape(f"Reconstruction of {folder.config.folder}")
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8">{content_policy()}<title>{title}</title>'
        f"<style>{STYLE}</style>"
        f"<h1>{title}</h1><p>Views that were {kind}. Red: the rendering is too bright; blue: too dark.{some}</p>"
        f"<table><tr><th></th><th>mean</th><th>worst</th></tr>{figures}</table>{turning}"
        f"<table><tr><th>photograph</th><th>rendering</th><th>difference</th><th></th></tr>{''.join(rows)}</table></html>\n"
    )


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


def _image(pixels: UInt8[np.ndarray, "H W 3"]) -> str:
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, format="PNG")
    return f'<img src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}" alt="">'
