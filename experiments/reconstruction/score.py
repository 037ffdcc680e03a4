"""Compares a reconstruction with the truth, which is in `truth/` of the folder of photographs.

    python -m experiments.reconstruction.score PHOTOS OUT --sky OTHER.hdr

It prints JSON with these figures:

- Chamfer distance: the mean of both directions, where the longest side of the true mesh is 1;
- PSNR (of the picture, and inside of the mask), SSIM and overlap of masks of the held-out views, for the pictures that
  were written;
- the same for `asset.glb` and the light, read back by `load_gltf`;
- PSNR under another sky, after one factor for each colour channel.

Where `truth/cameras.json` has the true cameras (see `spoil`), meshes and light are compared in the true world. The
similarity that brings the cameras of OUT closest to the true ones leads there, and `cameras` says how far these are
apart, in degrees.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxdr as jd
from experiments.reconstruction.cameras import alignment, camera_errors, pairs_of_poses, unit_axes
from jaxdr.images import load_image
from jaxdr.optimize.reconstruction.sky import TO_WORLD
from jaxdr.views.evaluate import Evaluation, score_pictures
from jaxdr.views.layouts.transforms import FROM_OPENGL
from jaxdr.views.pictures import Pixels

CAMERAS = "truth/cameras.json"
SPP, TRACER = 256, jd.PathTracer(max_depth=3, boundary=None)


def main() -> None:
    """Print all figures of one result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--sky", type=Path, required=True, help="the sky of truth/relit")
    options = parser.parse_args()
    photos, out = options.photos, options.out
    views = jd.load_views(out).held_out  # the same photographs, with cameras in the frame of the asset
    light = jd.EnvironmentMap(jd.load_image(next(out.glob("light.*"))))
    figures = {
        "chamfer": chamfer(out, photos),
        "asset": _summary(jd.evaluate_views(under(out, light, views), views, spp=SPP, integrator=TRACER)),
        "relit": _summary(relit(photos, out, options.sky)),
    }
    if (photos / CAMERAS).exists():
        figures["cameras"] = camera_errors(photos / CAMERAS, out / "transforms.json")
    if any((out / "test").glob("*.png")):  # a run that was stopped has none
        pictures = [_picture(out / "test" / f"{view.name}.png") for view in views]
        figures["pictures"] = _summary(score_pictures(pictures, views))
    print(json.dumps(figures, indent=2))


def under(out: Path, light: jd.EnvironmentMap, views: Sequence[jd.View]) -> jd.Scene:
    """The asset of a result under a sky."""
    return jd.Scene(jd.load_gltf(out / "asset.glb").shapes, views[0].camera, light)


def to_truth(photos: Path, out: Path) -> np.ndarray:
    """The similarity (4 x 4) from the frame of the asset to the true world."""
    true, found = photos / CAMERAS, out / "transforms.json"
    to_asset = np.array(json.loads(found.read_text())["to_asset"])
    aligned = alignment(pairs_of_poses(true, found)) if true.exists() else np.eye(4)
    return aligned @ np.linalg.inv(to_asset)


def relit(photos: Path, out: Path, sky: Path) -> Evaluation:
    """How the asset looks under the sky of `truth/relit`, after one factor for each colour channel."""
    back = np.linalg.inv(to_truth(photos, out))
    turn = np.eye(4)
    turn[:3, :3] = unit_axes(back)[:3, :3]
    pictures = photos / "truth" / "relit"
    if (photos / CAMERAS).exists():
        other = _true_views(photos, pictures, back)
    else:
        other = [_relit(view, pictures / f"r_{i}.png") for i, view in enumerate(jd.load_views(out).held_out)]
    scene = under(out, jd.EnvironmentMap(jd.load_image(sky), turn @ TO_WORLD), other)
    return jd.evaluate_views(scene, other, spp=SPP, integrator=TRACER, match_channels=True)


def _true_views(photos: Path, pictures: Path, back: np.ndarray) -> list[jd.View]:
    """Held-out views of the true cameras, in the frame of the asset: `back` leads there."""
    frames = json.loads((photos / CAMERAS).read_text())["frames"]
    views = []
    for i, frame in enumerate(frame for frame in frames if frame["held_out"]):
        path, pose = pictures / f"r_{i}.png", np.array(frame["transform_matrix"]) @ FROM_OPENGL
        place = unit_axes(back @ pose)
        pixels = load_image(path)
        picture = Pixels(pixels[..., :3], pixels[..., 3])
        views.append(jd.View(path.stem, path, picture, place, frame["fl_x"], (frame["cx"], frame["cy"]), True, False))
    return views


def chamfer(out: Path, photos: Path) -> float:
    """Of asset and true mesh in the true world: mean of both directions, over the longest side of the true mesh."""
    target, found = jd.load_mesh(photos / "truth/mesh.obj"), jd.load_mesh(out / "asset.glb")
    motion = to_truth(photos, out)
    found = found.with_vertices(np.asarray(found.vertices, float) @ motion[:3, :3].T + motion[:3, 3])
    extent = np.ptp(np.asarray(target.vertices), axis=0)
    return jd.chamfer(found, target) * float(np.linalg.norm(extent) / extent.max())


def _picture(path: Path) -> np.ndarray:
    """Linear RGB multiplied by alpha, and alpha."""
    pixels = jd.load_image(path)
    return np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], -1)


def _relit(view: jd.View, path: Path) -> jd.View:
    """The view with its photograph under the other sky."""
    pixels = load_image(path)
    return view.with_picture(pixels[..., :3], pixels[..., 3])


def _summary(evaluation: Evaluation) -> dict:
    return {name: value for name, value in evaluation.to_dict().items() if name != "views"}


if __name__ == "__main__":
    main()
