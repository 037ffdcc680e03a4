"""Copies a set of photographs and spoils the copy in one way, so that a reconstruction meets what real cameras do.

    python -m experiments.reconstruction.spoil PHOTOS OUT CASE

`PHOTOS` is a NeRF synthetic scene with alpha, or a COLMAP text model with `images` and `masks`; with `truth/`. `OUT`
has the same layout. Its `truth/` also has `cameras.json`: the cameras of the photographs before they were spoiled, by
the names of those in `OUT`, in instant-ngp's layout. `score` takes `OUT` as it takes `PHOTOS`.
"""

import argparse
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

import jaxdr as jd
from jaxdr.images import to_srgb
from jaxdr.optimize.reconstruction.sky import TO_WORLD
from jaxdr.views.layouts.transforms import FROM_OPENGL, lens_entries
from jaxdr.views.lens import Lens

BENT = (-0.12, 0.05, 0.001, -0.001)  # k1, k2, p1, p2 of COLMAP's OPENCV: a telephone's
FINER = 1.5  # pixels of a bent photograph along a side for one of the old: so resampling costs little of what it shows
SAMPLES = 4  # along each side of a pixel that is resampled
TALLER = 1.02
SIZES = (1.0, 0.75, 0.6)
GAIN = 1.3
ORIENTATION = 274  # EXIF's tag
TURNS = {6: 1, 8: -1, 3: 2}  # EXIF's orientations, and quarter turns to the left that make them necessary
NARROW = 10  # columns that both sides lose: the size tells which way is up, and the object has none of them


@dataclass(frozen=True)
class Photo:
    """A photograph: linear `colors`, `alpha` or a mask in [0, 1], `lens`, camera to world in OpenGL's axes (`pose`).

    `name`: of its file in the folder; `cut_out`: whether alpha is in it; `orientation`: EXIF's.
    """

    name: str
    held_out: bool
    cut_out: bool
    colors: np.ndarray
    alpha: np.ndarray
    lens: Lens
    pose: np.ndarray
    orientation: int = 1


def read(folder: Path) -> list[Photo]:
    """The photographs of a set."""
    return [
        Photo(
            view.path.relative_to(folder).as_posix(),
            view.held_out,
            not view.backdrop,
            view.image,
            view.alpha,
            view.lens,
            view.to_world @ FROM_OPENGL,
        )
        for view in jd.load_views(folder).views
    ]


# The cases. Each takes a photograph and its number.


def distortion(photo: Photo, number: int) -> Photo:
    """The lens of a telephone. The new photograph shows nothing that the old one does not."""
    return seen_through(photo, bent(photo.lens))


def aspect(photo: Photo, number: int) -> Photo:
    """Pixels that are not square: the focal lengths differ by 2 %."""
    (fx, fy), (x, y) = photo.lens.focal, photo.lens.centre
    size = photo.lens.width, round(TALLER * photo.lens.height)
    return seen_through(photo, Lens.pinhole((fx, TALLER * fy), (x, TALLER * y), size))


def sizes(photo: Photo, number: int) -> Photo:
    """One of three sizes. Pixels are means over their area."""
    share, lens = SIZES[number % len(SIZES)], photo.lens
    size = round(share * lens.width), round(share * lens.height)
    channels = [Image.fromarray(each.astype(np.float32)) for each in np.moveaxis(stacked(photo), -1, 0)]
    found = np.stack([np.asarray(each.resize(size, Image.Resampling.BOX)) for each in channels], -1)
    (fx, fy), (x, y) = lens.focal, lens.centre
    return with_pixels(photo, found, Lens.pinhole((share * fx, share * fy), (share * x, share * y), size))


def orientation(photo: Photo, number: int) -> Photo:
    """Stored turned, in one of three ways. Size and camera are those of the upright photograph."""
    rows, (x, y) = np.s_[:, NARROW:-NARROW], photo.lens.centre
    lens = Lens.pinhole(photo.lens.focal, (x - NARROW, y), (photo.lens.width - 2 * NARROW, photo.lens.height))
    turn = tuple(TURNS)[number % len(TURNS)]
    return replace(photo, colors=photo.colors[rows], alpha=photo.alpha[rows], lens=lens, orientation=turn)


def exposure(photo: Photo, number: int) -> Photo:
    """Brighter or darker by up to 30 %, if it is fitted. What was clipped becomes grey where it gets darker."""
    gain = GAIN ** np.random.default_rng(number).uniform(-1, 1)
    return photo if photo.held_out else replace(photo, colors=gain * photo.colors)


def unchanged(photo: Photo, number: int) -> Photo:
    """As it is: the case leaves out a file."""
    return photo


CASES: dict[str, Callable[[Photo, int], Photo]] = {
    "distortion": distortion,
    "aspect": aspect,
    "sizes": sizes,
    "orientation": orientation,
    "exposure": exposure,
    "no_masks": unchanged,
    "no_cameras": unchanged,
}


def bent(lens: Lens) -> Lens:
    """A lens with distortion and more pixels, narrow enough that all of them show what `lens` shows."""
    width, height = round(FINER * lens.width), round(FINER * lens.height)
    x, y = np.meshgrid(np.linspace(0, width, 50), np.linspace(0, height, 50))
    pixels = np.stack([x, y], -1).reshape(-1, 2)
    for share in np.arange(1.0, 1.2, 0.001):
        focal = [FINER * share * length for length in lens.focal]
        found = Lens("OPENCV", (*focal, width / 2, height / 2, *BENT), width, height)
        seen = lens.project(with_depth(found.directions(pixels)))
        if seen.min() >= 0 and np.all(seen <= [lens.width, lens.height]):
            return found
    raise ValueError("the lens bends too much")


def seen_through(photo: Photo, lens: Lens) -> Photo:
    """The photograph as another lens shows it: cubic interpolation of linear light, several samples in each pixel."""
    inside = (np.arange(SAMPLES) + 0.5) / SAMPLES
    x, y = ((np.arange(side)[:, None] + inside).ravel() for side in (lens.width, lens.height))
    directions = lens.directions(np.stack(np.meshgrid(x, y), -1).reshape(-1, 2))
    column, row = photo.lens.project(with_depth(directions)).T - 0.5
    channels = np.moveaxis(stacked(photo), -1, 0)
    found = np.stack([map_coordinates(each, (row, column), order=3, mode="nearest") for each in channels])
    found = found.reshape(4, lens.height, SAMPLES, lens.width, SAMPLES).mean((2, 4))
    return with_pixels(photo, np.moveaxis(found, 0, -1), lens)


def with_depth(directions: np.ndarray) -> np.ndarray:
    """Directions [N, 3] from their x and y where z is 1."""
    return np.concatenate([directions, np.ones((len(directions), 1))], -1)


def stacked(photo: Photo) -> np.ndarray:
    """Colours and alpha, of which means may be taken: colours without a backdrop count as far as they are there."""
    share = photo.alpha[..., None] if photo.cut_out else 1.0
    return np.concatenate([photo.colors * share, photo.alpha[..., None]], -1)


def with_pixels(photo: Photo, pixels: np.ndarray, lens: Lens) -> Photo:
    """The photograph with other pixels, as `stacked` has them."""
    colors, alpha = np.maximum(pixels[..., :3], 0.0), np.clip(pixels[..., 3], 0.0, 1.0)
    if photo.cut_out:
        colors = np.where(alpha[..., None] > 1 / 512, colors / np.maximum(alpha, 1 / 512)[..., None], 0.0)
    return replace(photo, colors=colors, alpha=alpha, lens=lens)


def before_sky(photo: Photo, sky: jd.EnvironmentMap, exposure: float) -> Photo:
    """The photograph with a sky where nothing was behind the object."""
    x, y = np.meshgrid(np.arange(photo.lens.width) + 0.5, np.arange(photo.lens.height) + 0.5)
    local = with_depth(photo.lens.directions(np.stack([x, y], -1).reshape(-1, 2))) * [1, -1, -1]
    world = local @ photo.pose[:3, :3].T
    world /= np.linalg.norm(world, axis=-1, keepdims=True)
    seen = exposure * np.asarray(sky.eval(world))
    share = photo.alpha[..., None]
    return replace(photo, colors=share * photo.colors + (1 - share) * seen.reshape(photo.colors.shape), cut_out=False)


# Files


def write(photos: list[Photo], folder: Path, case: str) -> None:
    """Write pictures, masks and cameras, as far as the case has them, in the layout that the names tell of."""
    masks = case != "no_masks"
    for photo in photos:
        write_picture(photo, folder / photo.name, masks)
    if case == "no_cameras":
        return
    if photos[0].name.startswith("images/"):
        write_model(photos, folder / "sparse/0")
        return
    for split, held_out in (("train", False), ("test", True)):
        frames = [frame(photo) for photo in photos if photo.held_out == held_out]
        (folder / f"transforms_{split}.json").write_text(json.dumps({"frames": frames}, indent=1))


def write_picture(photo: Photo, path: Path, masks: bool) -> None:
    """A PNG file; alpha is in it, or a mask lies in `masks`, which is upright."""
    colors, alpha = to_srgb(photo.colors), np.round(255 * photo.alpha).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    if photo.cut_out:
        colors = np.concatenate([colors * (alpha > 0)[..., None], alpha[..., None]], -1)
    elif masks:
        folder = path.parent.with_name("masks") if path.parent.name == "images" else path.parent / "masks"
        folder.mkdir(exist_ok=True)
        Image.fromarray((255 * (photo.alpha > 0.5)).astype(np.uint8)).save(folder / path.name)
    exif = Image.Exif()
    if photo.orientation in TURNS:
        colors, exif[ORIENTATION] = np.rot90(colors, TURNS[photo.orientation]), photo.orientation
    Image.fromarray(np.ascontiguousarray(colors)).save(path, exif=exif)


def frame(photo: Photo) -> dict:
    """A frame of instant-ngp's layout."""
    return {"file_path": photo.name, "transform_matrix": photo.pose.tolist(), **lens_entries(photo.lens)}


def write_model(photos: list[Photo], folder: Path) -> None:
    """A COLMAP text model, without points."""
    folder.mkdir(parents=True)
    lenses = list(dict.fromkeys(photo.lens for photo in photos))
    cameras = [
        " ".join(map(str, (number, lens.model, lens.width, lens.height, *map(float, lens.parameters))))
        for number, lens in enumerate(lenses, 1)
    ]
    images = []
    for number, photo in enumerate(photos, 1):
        to_camera = np.linalg.inv(photo.pose @ np.diag([1.0, -1.0, -1.0, 1.0]))
        x, y, z, w = Rotation.from_matrix(to_camera[:3, :3]).as_quat().tolist()
        words = (number, w, x, y, z, *to_camera[:3, 3].tolist(), lenses.index(photo.lens) + 1, Path(photo.name).name)
        images += [" ".join(map(str, words)), ""]
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", ["# empty"])):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")


def without_folders(photo: Photo) -> Photo:
    """Named by whether it is held out, and by its number, as `load_views` takes it where no cameras say more."""
    number = int(Path(photo.name).stem.split("_")[-1])
    return replace(photo, name=f"{'test' if photo.held_out else 'train'}_{number:03d}.png")


def spoil(source: Path, folder: Path, case: str, sky: Path | None = None) -> None:
    """Write the spoiled copy. `sky` is what is put behind objects that are cut out (`no_masks`)."""
    photos = read(source)
    if case == "no_cameras":
        photos = list(map(without_folders, photos))
    spoiled = [CASES[case](photo, number) for number, photo in enumerate(photos)]
    if case == "no_masks" and photos[0].cut_out:
        if sky is None:
            raise ValueError("no_masks: nothing is behind the object; give the sky of the photographs with --sky")
        words = (source / "truth/exposure.txt").read_text().split()
        light = jd.EnvironmentMap(jd.load_image(sky), TO_WORLD)
        spoiled = [before_sky(photo, light, float(words[words.index("photographs") + 1])) for photo in spoiled]
    shutil.copytree(source / "truth", folder / "truth")
    frames = [frame(photo) | {"held_out": photo.held_out} for photo in photos]
    (folder / "truth/cameras.json").write_text(json.dumps({"frames": frames}, indent=1))
    write(spoiled, folder, case)


def main() -> None:
    """Spoil a set of photographs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("case", choices=CASES)
    parser.add_argument("--sky", type=Path, help="no_masks of pictures with alpha: the sky under which they were taken")
    options = parser.parse_args()
    spoil(options.photos, options.out, options.case, options.sky)


if __name__ == "__main__":
    main()
