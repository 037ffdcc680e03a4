"""Compares a reconstruction with the truth, which is in `truth/` of the folder of photographs.

    python -m experiments.reconstruction.score PHOTOS OUT --sky OTHER.hdr

It prints JSON with these figures:

- Chamfer distance: the mean of both directions, where the longest side of the true mesh is 1;
- PSNR and overlap of masks of the held-out views, for the pictures that were written;
- the same for `asset.glb` and the light, read back by `load_gltf`;
- PSNR under another sky, after one factor for each colour channel.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxdr as jd
from jaxdr.images import load_image
from jaxdr.optimize.reconstruction.sky import TO_WORLD
from jaxdr.views.evaluate import Evaluation, score_pictures

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
        "chamfer": chamfer(out, photos / "truth" / "mesh.obj"),
        "asset": _summary(jd.evaluate_views(under(out, light, views), views, spp=SPP, integrator=TRACER)),
        "relit": _summary(relit(photos, out, options.sky)),
    }
    if any((out / "test").glob("*.png")):  # a run that was stopped has none
        pictures = [_picture(out / "test" / f"{view.name}.png") for view in views]
        figures["pictures"] = _summary(score_pictures(pictures, views))
    print(json.dumps(figures, indent=2))


def under(out: Path, light: jd.EnvironmentMap, views: Sequence[jd.View]) -> jd.Scene:
    """The asset of a result under a sky."""
    return jd.Scene(jd.load_gltf(out / "asset.glb").shapes, views[0].camera, light)


def to_asset(out: Path) -> np.ndarray:
    """The similarity from the world of the given cameras to the frame of the asset."""
    return np.array(json.loads((out / "transforms.json").read_text())["to_asset"])


def relit(photos: Path, out: Path, sky: Path) -> Evaluation:
    """How the asset looks under the sky of `truth/relit`, after one factor for each colour channel."""
    views, turn = jd.load_views(out).held_out, to_asset(out)
    turn[:3, :3] /= np.cbrt(np.linalg.det(turn[:3, :3]))
    turn[:3, 3] = 0
    other = [_relit(view, photos / "truth" / "relit" / f"r_{i}.png") for i, view in enumerate(views)]
    scene = under(out, jd.EnvironmentMap(jd.load_image(sky), turn @ TO_WORLD), views)
    return jd.evaluate_views(scene, other, spp=SPP, integrator=TRACER, match_channels=True)


def chamfer(out: Path, true: Path) -> float:
    """Of the asset and the true mesh in the world of the cameras: mean of both directions, over its longest side."""
    target, found, back = jd.load_mesh(true), jd.load_mesh(out / "asset.glb"), np.linalg.inv(to_asset(out))
    found = found.with_vertices(np.asarray(found.vertices, float) @ back[:3, :3].T + back[:3, 3])
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
