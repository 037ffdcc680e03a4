"""Loads folders of photographs with known cameras."""

import dataclasses
import os
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

from jaxdr.argument_kinds import checked
from jaxdr.callers_line import warn
from jaxdr.untrusted import whole
from jaxdr.views.frames import Frame, some_of
from jaxdr.views.layouts import colmap, llff, metashape, middlebury, neus, transforms
from jaxdr.views.masks import mask_in, warn_of_idle_masks
from jaxdr.views.pictures import PictureFile
from jaxdr.views.reading import Kept, read_ahead
from jaxdr.views.record import View, Views, common_point
from jaxdr.views.resample import UPRIGHT

# In a folder of several layouts the first one counts.
LAYOUTS: tuple[Any, ...] = (transforms, colmap, neus, llff, middlebury, metashape)
EVERY = 8  # if nothing says which pictures are held out, the first of so many is
KEEP = 1.0  # GiB of pictures that are kept in memory


@checked
def load_views(
    folder: str | os.PathLike,
    *,
    holdout: str | None = None,
    keep: float = KEEP,
    longest: int | None = None,
    masks: str | os.PathLike | None = None,
) -> Views:
    """Photographs with known cameras, from a folder.

    These layouts are known:

    - NeRF synthetic scenes: `transforms_train.json` and `transforms_test.json`.
    - instant-ngp, nerfstudio: `transforms.json`, with intrinsics for all frames or for each.
    - COLMAP: a model, text or binary, in `sparse/0`, `sparse` or the folder itself; pictures in `images`.
    - IDR, NeuS, DTU: `cameras_sphere.npz` or `cameras.npz`; pictures in `image` or `images`, in the order of the
      matrices, and so are masks whose names differ. The world is that of the normalised scene.
    - LLFF: `poses_bounds.npy`; pictures in `images`, or in the largest of `images_4`, `images_8`.
    - Middlebury multi-view: `NAME_par.txt`, pictures beside it.
    - Metashape: exported cameras in an XML file, pictures in `images` or beside it. Cameras without a pose are left
      out, with a warning. Disabled ones are left out, too.

    Names of pictures may lead out of the folder (`../images`), and files may be links. They must be regular files.
    Pictures that are missing are left out, with a warning.

    Pictures are resampled to pinholes with square pixels: lens distortion is taken away (by pycolmap), and `longest` is
    the most pixels along the longer side. Every pixel is the mean over its area, of linear light. Pictures may have
    several sizes and cameras. A picture that is smaller than its camera as a whole counts as reduced. Where the
    camera has the size of the upright picture, EXIF's orientation turns it. Pictures upside down, whose size does not
    tell, and square ones, are turned if the size tells so of another picture of the folder.

    PNG and JPEG hold sRGB; EXR, HDR and PFM hold linear RGB. Masks are white where the object is. They lie in `masks`
    or `mask` under the names of the pictures, beside the pictures as `NAME_mask.png`, or `mask_path` names them; PNG or
    JPEG, of any size, stored or upright. Without masks, alpha says where the object is. If only some of the pictures
    have either, the others are left out, with a warning. So are masks of no picture. `masks`: a folder of masks that
    count in place of all these.

    Some photographs are held out: frames of `transforms_test.json`, frames with `held_out` true (as `jaxdr reconstruct`
    writes them), pictures of a COLMAP model called `test_*`, and names that match the pattern `holdout` ("*_7",
    "test/*"). If that holds out none, and there are at least eight pictures, the first of every eight is held out.

    Headers are read now. Pixels are read when `View.image` or `View.alpha` is first used. As many as fit into `keep`
    GiB are kept; others are read again each time.

    Raises ValueError, with file, fault and remedy, for a folder of another kind, pictures that are all missing, damaged
    headers, damaged tables, pictures whose shape is not their camera's, panoramas, and cameras that look away from each
    other; ImportError for lens distortion without pycolmap. `View.image` and `View.alpha` raise ValueError if pixels
    are damaged or not finite, or if a mask is empty.
    """
    folder = Path(folder)
    if longest is not None:
        whole(longest, "load_views: longest", 1)
    if not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder; expected one with photographs and cameras")
    layout = next((layout for layout in LAYOUTS if layout.files(folder)), None)
    if layout is None:
        raise ValueError(
            f"{folder}: has no cameras that are known; expected {', '.join(layout.NAME for layout in LAYOUTS[:-1])} or "
            f"{LAYOUTS[-1].NAME}"
        )
    frames = layout.frames(folder)
    if masks is not None:
        frames = [dataclasses.replace(frame, mask=mask_in(Path(masks), frame.path)) for frame in frames]
        if not any(frame.mask for frame in frames):
            raise ValueError(f"{masks}: has no mask of any photograph; call that of NAME.jpg NAME.png")
    kept = Kept(int(keep * 2**30))
    pictures = _pictures(frames, kept, longest)
    if masks is None:
        warn_of_idle_masks(folder, {frame.mask for frame in frames if frame.mask})
    frames, pictures = _masked_alike(folder, frames, pictures)
    _check_directions(folder, frames)
    frames = _held_out(folder, frames, holdout)
    views = map(_view, frames, _names(folder, frames), pictures)
    return Views(folder, _without_idle_alpha(list(views)))


def has_cameras(folder: Path) -> bool:
    """Whether a folder has cameras in a layout that is known."""
    return any(layout.files(folder) for layout in LAYOUTS)


def _pictures(frames: Sequence[Frame], kept: Kept, longest: int | None) -> list[PictureFile]:
    """The pictures of frames.

    The size of a camera does not tell which way is up in a picture upside down, or a square one. If another picture of
    the folder is turned, the program that wrote the cameras heeded EXIF.
    """

    def read(frame: Frame, prefer_upright: bool = False) -> PictureFile:
        return PictureFile.of(frame.path, frame.mask, frame.lens, frame.source, kept, longest, prefer_upright)

    pictures = list(map(read, frames))
    turned = [picture.turn != UPRIGHT for picture in pictures]
    if not any(turned):
        return pictures
    pairs = zip(frames, pictures, turned, strict=True)
    return [picture if done else read(frame, prefer_upright=True) for frame, picture, done in pairs]


def _masked_alike(
    folder: Path, frames: Sequence[Frame], pictures: Sequence[PictureFile]
) -> tuple[list[Frame], list[PictureFile]]:
    """The frames that have a mask or alpha, if any has. Warns of those that are left out, with a count."""
    masked = [picture.masked for picture in pictures]
    chosen = [i for i, each in enumerate(masked) if each or not any(masked)]
    left = [picture.path.name for picture in pictures if not picture.masked and any(masked)]
    if left:
        warn(f"{folder}: {len(left)} of {len(frames)} photographs have no mask and are left out: {some_of(left)}")
    return [frames[i] for i in chosen], [pictures[i] for i in chosen]


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


def _view(frame: Frame, name: str, picture: PictureFile) -> View:
    _, _, focal, centre = picture.pinhole
    backdrop = not picture.masked or frame.mask is not None
    return View(name, frame.path, picture, frame.to_world, focal, centre, frame.held_out, backdrop)


def _without_idle_alpha(views: Sequence[View]) -> tuple[View, ...]:
    """The views. They lose their alpha where it is 1 everywhere: then it is only a channel of the format."""
    opaque = all(view.masked for view in views) and all(read_ahead(_is_opaque, views))  # most often the first ends this
    if opaque:
        return tuple(dataclasses.replace(view, picture=view.picture.without_alpha(), backdrop=True) for view in views)
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
