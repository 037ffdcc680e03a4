"""What parts of a reconstruction bring, and what photographs that are not as they should be cost.

    python -m experiments.reconstruction.variants PHOTOS --share 0.5 --sky OTHER.hdr

`PHOTOS`: photographs with `truth/`; for cases that change them, a NeRF synthetic scene. `--sky`: that of `truth/relit`.
Each case changes a copy of the photographs or some settings. It runs in a process of its own. `--share` is that of the
default steps. Held-out photographs are never changed. Rows of other cases stay in the table.
"""

import dataclasses
import io
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from experiments import common

STUDY = "reconstruction"
COLUMNS = {
    "case": ("case", ""),
    "PSNR": ("psnr", ".2f"),
    "worst": ("psnr_worst", ".2f"),
    "SSIM": ("ssim", ".3f"),
    "other sky": ("relit", ".2f"),
    "worst there": ("relit_worst", ".2f"),
    "overlap of masks": ("iou", ".4f"),
    "Chamfer": ("chamfer", ".4f"),
    "cameras, degrees": ("camera_rms", ".3f"),
    "aligned": ("camera_rms_aligned", ".3f"),
    "seconds": ("seconds", ".0f"),
}


class Case(NamedTuple):
    """Settings that differ from the defaults, and what is done to a copy of the photographs."""

    settings: dict
    change: Callable[[Path], None] | None = None


def each_picture(change: Callable[[np.ndarray, int], np.ndarray]) -> Callable[[Path], None]:
    """Change the pixels (8-bit sRGB with alpha) of the photographs to fit; `change` gets their numbers, too."""

    def changed(folder: Path) -> None:
        for number, frame in enumerate(_frames(folder)):
            path = folder / f"{frame['file_path']}.png"
            Image.fromarray(change(np.array(Image.open(path)), number)).save(path)

    return changed


def as_jpeg(pixels: np.ndarray, number: int) -> np.ndarray:
    """The colours after JPEG compression of quality 75."""
    file = io.BytesIO()
    Image.fromarray(pixels[..., :3]).save(file, format="JPEG", quality=75)
    return np.concatenate([np.array(Image.open(file)), pixels[..., 3:]], -1)


def exposed(pixels: np.ndarray, number: int) -> np.ndarray:
    """Linear colours times a factor between 0.8 and 1.2 of the photograph."""
    from jaxdr.images import from_srgb, to_srgb

    factor = np.random.default_rng(number).uniform(0.8, 1.2)
    linear = np.asarray(from_srgb(pixels[..., :3] / 255), float)
    return np.concatenate([to_srgb(factor * linear), pixels[..., 3:]], -1)


def wide_mask(pixels: np.ndarray, number: int) -> np.ndarray:
    """The mask a pixel too large on every side."""
    from scipy.ndimage import maximum_filter

    return np.concatenate([pixels[..., :3], maximum_filter(pixels[..., 3], 3)[..., None]], -1)


def turned_cameras(folder: Path) -> None:
    """Turn every camera on the spot by one degree about a random axis."""
    from scipy.spatial.transform import Rotation

    def turn(frames):
        axes = np.random.default_rng(0).normal(size=(len(frames), 3))
        for frame, axis in zip(frames, axes, strict=True):
            pose = np.array(frame["transform_matrix"])
            pose[:3, :3] = (
                Rotation.from_rotvec(np.radians(1.0) * axis / np.linalg.norm(axis)).as_matrix() @ pose[:3, :3]
            )
            frame["transform_matrix"] = pose.tolist()
        return frames

    _edit(folder, turn)


def twelve(folder: Path) -> None:
    """Every fourth photograph of 48."""
    _edit(folder, lambda frames: frames[:: max(1, len(frames) // 12)])


CASES = {
    "as it is": Case({}),
    "without boundary terms": Case({"integrator": {"boundary": "none"}}),
    "with interreflection": Case({"integrator": {"max_depth": 3}}),
    "albedo alone unknown": Case({"unknown": ["albedo"]}),
    "light alone unknown": Case({"unknown": ["light"]}),
    "without the prior of masks": Case({"priors": {"mask": 0.0}}),
    "without the prior of the albedo": Case({"priors": {"albedo": 0.0}}),
    "without the prior of the light": Case({"priors": {"light": 0.0}}),
    "without the prior of white light": Case({"priors": {"white": 0.0}}),
    "without the background": Case({"priors": {"background": 0.0}}),
    "12 photographs": Case({}, twelve),
    "JPEG of quality 75": Case({}, each_picture(as_jpeg)),
    "masks a pixel too large": Case({}, each_picture(wide_mask)),
    "exposures differ by 20 %": Case({}, each_picture(exposed)),
    "the same, exposure unknown": Case(
        {"unknown": ["albedo", "roughness", "light", "exposure"]}, each_picture(exposed)
    ),
    "cameras off by 1°": Case({}, turned_cameras),
    "the same, cameras unknown": Case({"unknown": ["albedo", "roughness", "light", "cameras"]}, turned_cameras),
}


def _edit(folder: Path, change: Callable[[list], list]) -> None:
    path = folder / "transforms_train.json"
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"frames": change(document["frames"])}))


def _frames(folder: Path) -> list[dict]:
    return json.loads((folder / "transforms_train.json").read_text())["frames"]


def run(name: str, photos: Path, work: Path, share: float, sky: Path | None) -> dict:
    """The row of a case; a fresh process. With `sky` also what it looks like under another one."""
    from experiments.reconstruction.cameras import camera_errors
    from experiments.reconstruction.score import chamfer, relit
    from jaxdr.optimize.reconstruction.config import LEVELS, reconstruct_config
    from jaxdr.optimize.reconstruction.reconstruct import reconstruct

    case, folder = CASES[name], work / "photos"
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(photos, folder, ignore=shutil.ignore_patterns("truth"))
    if case.change is not None:
        case.change(folder)
    levels = [dataclasses.asdict(level) for level in LEVELS]
    for level in levels:
        level["steps"] = max(1, round(share * level["steps"]))
    table = {"levels": levels, "samples": {"pictures": 64}, "report": {"turntable": 0}} | case.settings
    start = time.perf_counter()
    found = reconstruct(reconstruct_config(table, name, str(folder), str(work / "out")))
    seconds = time.perf_counter() - start
    figures = {name: found[name]["mean"] for name in ("psnr", "ssim", "iou")}
    figures |= {
        "psnr_worst": found["psnr"]["worst"],
        "chamfer": chamfer(work / "out", photos),
    }
    if "camera" in name:
        errors = camera_errors(photos / "transforms_train.json", work / "out/transforms.json")
        figures |= {"camera_rms": errors["rms"], "camera_rms_aligned": errors["rms_aligned"]}
    if sky is not None:
        other = relit(photos, work / "out", sky).to_dict()["psnr"]
        figures |= {"relit": other["mean"], "relit_worst": other["worst"]}
    return {"case": name, "seconds": seconds} | figures


def main() -> None:
    """Run the cases, keep the rows, print the table."""
    parser = common.parser(__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--case", choices=CASES, action="append", help="may be repeated; default: all")
    parser.add_argument("--share", type=float, default=1.0, help="share of the default steps")
    parser.add_argument("--sky", type=Path)
    options = parser.parse_args()
    share = 0.01 if options.quick else options.share
    path = common.results(STUDY, options.quick) / f"variants_{options.photos.name}_{round(100 * share)}.json"
    same = {"photographs": options.photos.name, "share": share}
    known = json.loads(path.read_text()) if path.exists() else {}
    rows = {row["case"]: row for row in known.get("rows", ()) if {key: known[key] for key in same} == same}
    for name in options.case or CASES:
        work = common.scratch(STUDY) / "variant"
        rows[name] = common.in_fresh_process(run, name, options.photos, work, share, options.sky)
        ordered = [rows[case] for case in CASES if case in rows]
        print(common.table(ordered, COLUMNS), flush=True)
        common.write_json(path, same | {"rows": ordered})


if __name__ == "__main__":
    main()
