"""Loads folders of photographs with known cameras."""

import dataclasses
import os
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from jaxdr.views.colmap import colmap_frames, find_model
from jaxdr.views.frames import Frame
from jaxdr.views.pictures import PictureFile, check_masks_have_pictures
from jaxdr.views.reading import Kept, read_ahead
from jaxdr.views.record import View, Views, common_point
from jaxdr.views.transforms import is_transforms, transforms_frames

EVERY = 8  # if nothing says which pictures are held out, the first of so many is
KEEP = 1.0  # GiB of pictures that are kept in memory


def load_views(folder: str | os.PathLike, *, holdout: str | None = None, keep: float = KEEP) -> Views:
    """Photographs with known cameras, from a folder.

    These layouts are known:

    - NeRF synthetic scenes: `transforms_train.json` and `transforms_test.json`.
    - instant-ngp: `transforms.json`, with intrinsics for all frames or for each.
    - COLMAP: a model, text or binary, in `sparse/0`, `sparse` or the folder itself; pictures in `images`.

    Names of pictures may lead out of the folder (`../images`), and files may be links. They must be regular files.

    PNG and JPEG hold sRGB; EXR, HDR and PFM hold linear RGB. Masks are white where the object is. They lie in `masks`
    under the names of the pictures, or `mask_path` names them. Without masks, alpha says where the object is.

    Some photographs are held out: frames of `transforms_test.json`, frames with `held_out` true (as `jaxdr reconstruct`
    writes them), pictures of a COLMAP model called `test_*`, and names that match the pattern `holdout` ("*_7",
    "test/*"). If that holds out none, and there are at least eight pictures, the first of every eight is held out.

    All pictures have one size. Their headers are read now. Their pixels are read when `View.image` or `View.alpha` is
    first used. As many as fit into `keep` GiB are kept; others are read again each time.

    Raises ValueError, with file, fault and remedy, for a folder of another kind, missing pictures, damaged headers,
    damaged tables, masks without pictures, pictures without masks, sizes that differ, lenses other than pinholes, and
    cameras that look away from each other. `View.image` and `View.alpha` raise ValueError if pixels are damaged or not
    finite, or if a mask is empty.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder; expected one with photographs and cameras")
    if is_transforms(folder):
        frames = transforms_frames(folder)
    elif find_model(folder) is not None:
        frames = colmap_frames(folder)
    else:
        raise ValueError(
            f"{folder}: has neither transforms.json, transforms_train.json nor a COLMAP model (sparse/0/cameras.bin or "
            ".txt); cameras must be known"
        )
    check_masks_have_pictures(folder, {frame.mask for frame in frames if frame.mask})
    _check_directions(folder, frames)
    frames = _held_out(folder, frames, holdout)
    names = _names(folder, frames)
    return Views(folder, _without_idle_alpha(_views(frames, names, Kept(int(keep * 2**30)))))


def _held_out(folder: Path, frames: Sequence[Frame], holdout: str | None) -> list[Frame]:
    """The frames, with `held_out` set."""

    chosen = [frame.held_out for frame in frames]
    if holdout is not None:
        matching = [_matches(frame.path, folder, holdout) for frame in frames]
        if not any(matching):
            raise ValueError(f"{folder}: no picture matches the holdout pattern {holdout!r}; take another one")
        chosen = [a or b for a, b in zip(chosen, matching, strict=True)]
    if not any(chosen) and len(frames) >= EVERY:
        chosen = [i % EVERY == 0 for i in range(len(frames))]
    if all(chosen):
        raise ValueError(f"{folder}: all pictures are held out, none is left to fit; hold out fewer")
    return [dataclasses.replace(frame, held_out=held) for frame, held in zip(frames, chosen, strict=True)]


def _matches(path: Path, folder: Path, pattern: str) -> bool:
    """Whether a pattern matches the name of a picture, with or without suffix, or its path in the folder."""
    relative = path.relative_to(folder).as_posix() if path.is_relative_to(folder) else ""
    return any(fnmatch(name, pattern) for name in (path.name, path.stem, relative))


def _names(folder: Path, frames: Sequence[Frame]) -> list[str]:
    """Names of files without suffix. If two fitted or two held-out pictures share one, names contain the folders."""
    stems = [(frame.held_out, frame.path.stem) for frame in frames]
    if len(set(stems)) == len(stems):
        return [stem for _, stem in stems]
    names = []
    for frame in frames:
        path = frame.path.relative_to(folder) if frame.path.is_relative_to(folder) else frame.path
        names.append("_".join(path.with_suffix("").parts).strip("_/\\"))
    return names


def _views(frames: Sequence[Frame], names: Sequence[str], kept: Kept) -> list[View]:
    """The frames with their pictures, whose headers are read."""
    views: list[View] = []
    for frame, name in zip(frames, names, strict=True):
        picture = PictureFile.of(frame.path, frame.mask, kept)
        width, height = picture.width, picture.height
        if views and (width, height) != (views[0].width, views[0].height):
            raise ValueError(
                f"{frame.path}: has {width} x {height} pixels, {views[0].path.name} has {views[0].width} x "
                f"{views[0].height}; all photographs must be of one size"
            )
        focal, centre = frame.lens(width, height)
        backdrop = not picture.masked or frame.mask is not None
        views.append(View(name, frame.path, picture, frame.to_world, focal, centre, frame.held_out, backdrop))
    return views


def _without_idle_alpha(views: Sequence[View]) -> tuple[View, ...]:
    """The views. They lose their alpha if the object fills every picture: then alpha is only a channel of the format.

    Raises ValueError if only some of the pictures have a mask or alpha.
    """
    masked = [view.masked for view in views]
    if all(masked) and all(read_ahead(_is_opaque, views)):  # most often the first picture ends this
        return tuple(dataclasses.replace(view, picture=view.picture.without_alpha(), backdrop=True) for view in views)
    for view in views:
        if not view.masked and any(masked):
            raise ValueError(
                f"{view.path}: has no mask and no alpha, other pictures have; give all of them one, or none"
            )
    return tuple(views)


def _is_opaque(view: View) -> bool:
    return bool((view.alpha == 1).all())


def _check_directions(folder: Path, frames: Sequence[Frame]) -> None:
    """Raises ValueError if the point nearest to all camera axes is behind most of the cameras."""
    poses = np.stack([frame.to_world for frame in frames])
    if len(frames) < 2:
        return
    depth = np.einsum("ni,ni->n", common_point(poses) - poses[:, :3, 3], poses[:, :3, 2])
    behind = int((depth <= 0).sum())
    if 2 * behind > len(frames):
        raise ValueError(
            f"{folder}: {behind} of {len(frames)} cameras look away from the point nearest to their axes, so they see "
            "nothing in common; check that poses are camera to world and look along -z (COLMAP: world to camera, +z)"
        )
