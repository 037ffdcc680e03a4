"""Photographs without cameras: which files of a folder they are, whether they can be read, and who shares a camera."""

import hashlib
import os
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from jaxdr.images import ENCODED, load_stored
from jaxdr.untrusted import damage, reason
from jaxdr.views.masks import FOLDERS, is_mask
from jaxdr.views.reading import read_ahead

FEWEST = 3
# Of photographs that jaxdr does not read, for a message.
RAW = (
    ".heic",
    ".heif",
    ".avif",
    ".webp",
    ".tif",
    ".tiff",
    ".dng",
    ".cr2",
    ".cr3",
    ".nef",
    ".arw",
    ".raf",
    ".orf",
    ".rw2",
)
VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")
FOCAL, FOCAL_35, EXIF = 37386, 41989, 0x8769  # EXIF: focal length in mm, that of 35 mm film, and the table with both
MODEL = 272


@dataclass(frozen=True)
class Photographs:
    """Names of photographs, relative to `folder`, in lists that share a camera; and files of other kinds, by suffix."""

    folder: Path
    cameras: tuple[tuple[str, ...], ...]
    others: dict[str, int]

    @property
    def names(self) -> list[str]:
        """All names, sorted."""
        return sorted(name for names in self.cameras for name in names)


def find_photographs(folder: Path) -> Photographs:
    """The photographs of a folder, or of its subfolders if there are none at its top. Masks and hidden files are none.

    Photographs of one size, focal length and model of camera share a camera. All are read once.

    Raises ValueError, with the place and the remedy, for fewer than three, a damaged one, and if all are the same.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder; expected one with photographs")
    try:
        files = _files(folder)
    except OSError as problem:
        raise ValueError(f"{folder}: can't be read ({reason(problem)})") from problem
    found = sorted(path for path in files if path.suffix.lower() in ENCODED)
    others = dict(Counter(suffix for path in files if (suffix := path.suffix.lower()) in RAW + VIDEOS))
    if len(found) < FEWEST:
        raise ValueError(f"{folder}: has {len(found)} photographs ({', '.join(ENCODED)}){_instead(others)}")
    base = Path(os.path.commonpath([path.parent for path in found]))
    groups, digests = defaultdict(list), set()
    for path, (digest, camera) in zip(found, read_ahead(_read, found), strict=True):
        groups[camera].append(path.relative_to(base).as_posix())
        digests.add(digest)
    if len(digests) == 1:
        raise ValueError(f"{folder}: all {len(found)} photographs are the same; cameras need views from several places")
    return Photographs(base, tuple(map(tuple, groups.values())), others)


def _files(folder: Path) -> list[Path]:
    """Visible files that are no masks: those at the top if a photograph is among them, else those of all subfolders."""
    top = [path for path in folder.iterdir() if _counts(path, folder)]
    if any(path.suffix.lower() in ENCODED for path in top):
        return top
    return [path for path in folder.rglob("*") if _counts(path, folder)]


def _counts(path: Path, folder: Path) -> bool:
    parts = path.relative_to(folder).parts
    hidden = any(part.startswith(".") for part in parts)
    return path.is_file() and not hidden and not is_mask(path) and not set(parts[:-1]) & set(FOLDERS)


def _instead(others: dict[str, int]) -> str:
    """What to do where there are too few photographs."""
    if any(suffix in VIDEOS for suffix in others):
        return f"; take at least {FEWEST} pictures out of the video ({', '.join(others)})"
    if others:
        return f"; save those in {', '.join(others)} as JPEG or PNG, at least {FEWEST}"
    return f"; cameras need at least {FEWEST}, and 30 or more that overlap are better"


def _read(path: Path) -> tuple[str, tuple]:
    """(digest of the file, what those who share its camera have in common). Raises ValueError for a damaged file."""
    try:
        load_stored(path)  # the whole: pycolmap takes grey pixels for those behind the end of a file that is cut off
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as problem:
        raise ValueError(f"{path}: can't be read ({reason(problem)}); restore it or take it out") from problem
    except ValueError as problem:
        raise ValueError(f"{problem}; restore it or take it out") from problem
    return digest, _camera(path)


def _camera(path: Path) -> tuple:
    """Size, model and focal lengths, as far as the file says."""
    with Image.open(path) as image:
        size = image.size
        try:
            with damage("EXIF"):
                exif = image.getexif()
                lens = exif.get_ifd(EXIF)
                return *size, str(exif.get(MODEL)), *(str(lens.get(tag)) for tag in (FOCAL, FOCAL_35))
        except ValueError:
            return *size, "", "", ""
