"""Masks beside photographs, under the names that people and programs give them."""

from collections.abc import Iterable
from pathlib import Path

from jaxdr.callers_line import warn

FOLDERS = ("masks", "mask")
SUFFIXES = (".png", ".jpg", ".jpeg")


def find_mask(folder: Path, picture: Path, name: str) -> Path | None:
    """The mask of a picture that a file calls `name`; None if there is none.

    - In `masks` or `mask`: under the name of the picture, with another suffix, with one more suffix as COLMAP has it
      (`NAME.jpg.png`), or as `NAME_mask.png`.
    - Beside the picture: `NAME_mask.png`.

    Masks are PNG or JPEG. Of a picture that is elsewhere, only the last part of its name counts.
    """
    relative = Path(name).with_suffix(picture.suffix)
    if relative.is_absolute() or ".." in relative.parts:
        relative = Path(relative.name)  # else the picture could be its own mask
    # Some list pictures with their folder: `images/NAME.jpg`.
    inner = Path(*relative.parts[1:]) if len(relative.parts) > 1 else relative
    for place in (place for place in map(folder.joinpath, FOLDERS) if place.is_dir()):
        for each in dict.fromkeys((relative, inner)):
            for candidate in _called(place / each):
                if candidate.is_file():
                    return candidate
    beside = (picture.with_name(f"{picture.stem}_mask{suffix}") for suffix in SUFFIXES)
    return next((candidate for candidate in beside if candidate.is_file()), None)


def mask_in(folder: Path, picture: Path) -> Path | None:
    """The mask of a picture in a folder of masks. Raises ValueError if there is no such folder."""
    if not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder; expected one with masks")
    return next((path for path in _called(folder / picture.name) if path.is_file() and path != picture), None)


def _called(path: Path) -> Iterable[Path]:
    for suffix in SUFFIXES:
        yield from (path.with_suffix(suffix), path.with_name(path.name + suffix))
        yield path.with_name(f"{path.stem}_mask{suffix}")


def is_mask(path: Path) -> bool:
    """Whether a file beside photographs is a mask by its name."""
    return path.stem.endswith("_mask")


def warn_of_idle_masks(folder: Path, used: set[Path]) -> None:
    """Warns of masks that belong to no picture, with a count."""
    there = [path for name in FOLDERS for suffix in SUFFIXES for path in (folder / name).rglob(f"*{suffix}")]
    left = sorted(set(there) - used)
    if left and used:
        first = left[0].relative_to(folder)
        warn(f"{folder}: {len(left)} masks belong to no photograph and are not used, {first} for one")
    elif left:
        warn(
            f"{folder}: none of the {len(left)} masks is called like a photograph, so there are no masks; call that of "
            "NAME.jpg masks/NAME.png"
        )
