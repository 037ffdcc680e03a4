"""The pictures of a folder of photographs. Headers are checked at once; colours and masks are read when needed."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from jaxdr.image_formats.png import shares
from jaxdr.images import READERS, image_size, linear_of, load_stored
from jaxdr.untrusted import reason, shortened
from jaxdr.views.lens import Lens, Pinhole, alike
from jaxdr.views.reading import Kept
from jaxdr.views.resample import UNDONE, UPRIGHT, in_file, orientation, resampled, turned, turned_size

LONGEST_NAME, LONGEST_PATH = 240, 2000  # bytes; with a suffix and a folder systems take 255 and 4096
Colors = tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"] | None]


class MissingPicture(ValueError):
    """A picture that a file names is not there. `name`: what it is called there."""

    def __init__(self, message: str, name: str):
        super().__init__(message)
        self.name = name


class CannotRead(ValueError):
    """A picture can't be read. The message names the file, the reason and the remedy."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """A picture in memory: linear RGB, not multiplied by alpha, and alpha or None."""

    image: Float[np.ndarray, "H W 3"]
    alpha: Float[np.ndarray, "H W"] | None = None

    @property
    def width(self) -> int:
        """Width, in pixels."""
        return self.image.shape[1]

    @property
    def height(self) -> int:
        """Height, in pixels."""
        return self.image.shape[0]

    @property
    def masked(self) -> bool:
        """Whether there is alpha."""
        return self.alpha is not None

    def without_alpha(self) -> "Pixels":
        """The same picture without alpha."""
        return Pixels(self.image)

    def cut_by(self, mask: Bool[np.ndarray, "H W"]) -> "Pixels":
        """The same picture with a mask."""
        return Pixels(self.image, mask.astype(self.image.dtype))

    def read(self) -> Colors:
        """(linear RGB, alpha or None)."""
        return self.image, self.alpha


@dataclass(frozen=True, eq=False)
class PictureFile:
    """A picture in a file, with a mask in another file or none, as a pinhole with square pixels sees it.

    `lens`: of the file; `longest`: most pixels along the longer side, or None. `width`, `height`, and whether it is
    `masked`, are known from the headers. Pixels are read when they are needed. `kept` keeps them in memory as far as
    there is room. `turn`, `mask_turn`: how files are turned first, as orientations of EXIF. `made`: where the object
    is, in place of a mask in a file.
    """

    path: Path
    mask: Path | None
    lens: Lens
    longest: int | None
    masked: bool
    kept: Kept
    turn: int = UPRIGHT
    mask_turn: int = UPRIGHT
    made: Bool[np.ndarray, "H W"] | None = None

    @classmethod
    def of(
        cls,
        path: Path,
        mask: Path | None,
        told: Lens,
        source: str,
        kept: Kept,
        longest: int | None = None,
        prefer_upright: bool = False,
    ) -> "PictureFile":
        """A picture from its headers, and what `source` tells of its lens.

        The camera's size tells whether its picture is the one that is stored, or the upright one of EXIF. Where both
        have this size, `prefer_upright` decides. A mask may be either, too, and of another size.

        Raises ValueError, with the file, for headers that are damaged or don't agree.
        """
        width, height, channels = image_size(path)
        exif = orientation(path)
        stored, upright = (width, height), turned_size((width, height), exif)
        both = stored == upright
        turn = exif if (told.width, told.height) == upright and (prefer_upright or not both) else UPRIGHT
        size = turned_size(stored, turn)
        lens = told.of_picture(*size, source, path.name)
        mask_turn = UPRIGHT
        if mask is not None and not alike(found := image_size(mask)[:2], size):
            mask_turn = exif if turn != UPRIGHT else UNDONE.get(exif, exif)
            if exif == UPRIGHT or not alike(turned_size(found, mask_turn), size):
                raise ValueError(
                    f"{mask}: the mask has {found[0]} x {found[1]} pixels, {path.name} has {size[0]} x {size[1]}; "
                    "resize it"
                )
        try:
            lens.target(longest)
        except ValueError as problem:
            raise ValueError(f"{source}: {problem}") from problem
        return cls(path, mask, lens, longest, mask is not None or channels == 4, kept, turn, mask_turn)

    @property
    def pinhole(self) -> Pinhole:
        """The camera of the pixels that `read` returns."""
        return self.lens.target(self.longest)[1]

    @property
    def width(self) -> int:
        """Width, in pixels."""
        return self.pinhole.width

    @property
    def height(self) -> int:
        """Height, in pixels."""
        return self.pinhole.height

    def without_alpha(self) -> "PictureFile":
        """The same picture without alpha."""
        return dataclasses.replace(self, masked=False)

    def cut_by(self, mask: Bool[np.ndarray, "H W"]) -> "PictureFile":
        """The same picture with a mask of its resampled pixels."""
        return dataclasses.replace(self, mask=None, masked=True, made=mask)

    def made_in_file(self) -> Bool[np.ndarray, "h w"]:
        """The mask that was made, for the picture as the lens shows it, at about the size of the resampled one."""
        assert self.made is not None, "no mask was made"
        return in_file(self.made, self.lens, self.longest)

    def read(self) -> Colors:
        """(linear RGB, alpha or None), which must not be written to. Raises `CannotRead`, with the file."""
        image, alpha = self.kept.get((self.path, self.mask), self._read)
        if self.made is not None:
            return image, self.made.astype(image.dtype)
        return image, alpha if self.masked else None

    def _read(self) -> Colors:
        try:
            image, alpha = self._colors(), None
            if self.mask is not None:
                alpha = self._mask_of(self.mask)
            elif image.shape[2] == 4:
                alpha = np.ascontiguousarray(image[..., 3])
            _check_mask(alpha, self.mask or self.path)
        except CannotRead:
            raise
        except ValueError as problem:
            raise CannotRead(str(problem)) from problem
        except OSError as problem:
            raise CannotRead(f"{self.path}: can't be read ({reason(problem)})") from problem
        if self.masked and alpha is None and self.made is None:
            raise CannotRead(_changed(self.path))
        image = np.ascontiguousarray(image[..., :3])
        for pixels in (image, alpha):
            if pixels is not None:
                pixels.flags.writeable = False  # other callers may get the same array
        return image, alpha

    def _colors(self) -> Float[np.ndarray, "H W C"]:
        """Linear RGB, or RGB, not multiplied by alpha, and alpha."""
        stored = turned(_finite(self.path), self.turn)
        if stored.shape[1::-1] != (self.lens.width, self.lens.height):
            raise CannotRead(_changed(self.path))
        multiplied = self.path.suffix.lower() == ".exr"  # as these files have it

        def values(rows: np.ndarray) -> Float[np.ndarray, "h w C"]:
            found = linear_of(rows)
            if found.shape[2] < 4:
                return np.repeat(found, 3, axis=2) if found.shape[2] == 1 else found
            alpha = np.clip(found[..., 3:], 0.0, 1.0)
            return np.concatenate([_divided(found[..., :3], alpha) if multiplied else found[..., :3], alpha], -1)

        as_it_is = self.lens.straight and self.pinhole[:2] == stored.shape[1::-1]
        if stored.shape[2] < 4 or self.mask is not None or as_it_is:
            return resampled(stored, values, self.lens, self.longest)

        def weighted(rows: np.ndarray) -> Float[np.ndarray, "h w 4"]:
            found = values(rows)
            found[..., :3] *= found[..., 3:]
            return found

        # What is transparent has no share in the colour of a mean.
        found = resampled(stored, weighted, self.lens, self.longest)
        return np.concatenate([_divided(found[..., :3], found[..., 3:]), found[..., 3:]], -1)

    def _mask_of(self, path: Path) -> Float[np.ndarray, "H W"]:
        stored = turned(_finite(path), self.mask_turn)
        # The alpha of a mask that has one counts, not its colour.
        chosen = np.s_[..., 3:] if stored.shape[2] == 4 else np.s_[..., :1]

        def values(rows: np.ndarray) -> Float[np.ndarray, "h w 1"]:
            return shares(rows[chosen]) if rows.dtype.kind == "u" else rows[chosen]

        return np.clip(resampled(stored, values, self.lens, self.longest)[..., 0], 0.0, 1.0)


def _finite(path: Path) -> np.ndarray:
    stored = load_stored(path)
    if not np.isfinite(stored).all():
        raise ValueError(f"{path}: has pixels that are not finite; write it anew without NaN and infinity")
    return stored


def _divided(colors: Float[np.ndarray, "H W 3"], alpha: Float[np.ndarray, "H W 1"]) -> Float[np.ndarray, "H W 3"]:
    return colors / np.where(alpha > 0, alpha, np.float32(1.0))


def _check_mask(alpha: Float[np.ndarray, "H W"] | None, source: Path) -> None:
    if alpha is not None and not (alpha > 0.5).any():
        raise ValueError(f"{source}: the mask is empty, the object is nowhere; take this photograph out")


def _changed(path: Path) -> str:
    return f"{path}: is another picture than its header said; was it changed meanwhile?"


def find_picture(base: Path, name: str, said_by: Path) -> Path:
    """The file of a picture whose name may lack its suffix. be outside of `base`, and it may be a link.

    Raises ValueError for a name that is none, and `MissingPicture`, with the file that names the picture.
    """
    path = base / name
    if not Path(name).name.strip(".") or not _is_possible(name):
        raise ValueError(f"{said_by}: names a picture {shortened(name)}; expected the path of a file")
    if path.suffix.lower() in READERS:
        candidates = [path]
    else:
        candidates = [path.with_name(path.name + suffix) for suffix in READERS]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    looked = candidates[0] if len(candidates) == 1 else f"{path} with any of {', '.join(READERS)}"
    raise MissingPicture(
        f"{said_by}: names a picture that is missing: {looked}; restore it or take its entry out", name
    )


def _is_possible(name: str) -> bool:
    """Whether a name can be that of a file. Systems raise errors for others, which do not say where they are from."""
    try:
        encoded = name.encode()
    except UnicodeEncodeError:
        return False
    longest = max(map(len, encoded.split(b"/")))
    return min(name, default=" ") >= " " and longest <= LONGEST_NAME and len(encoded) <= LONGEST_PATH
