"""The pictures of a folder of photographs. Headers are checked at once; colours and masks are read when needed."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.images import READERS, image_size, load_image
from jaxdr.untrusted import reason, shortened
from jaxdr.views.reading import Kept

LONGEST_NAME, LONGEST_PATH = 240, 2000  # bytes; with a suffix and a folder systems take 255 and 4096
Colors = tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"] | None]


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

    def read(self) -> Colors:
        """(linear RGB, alpha or None)."""
        return self.image, self.alpha


@dataclass(frozen=True, eq=False)
class PictureFile:
    """A picture in a file, with a mask in another file or none.

    `width`, `height`, and whether it is `masked`, are known from the headers. Pixels are read when they are needed.
    `kept` keeps them in memory as far as there is room.
    """

    path: Path
    mask: Path | None
    width: int
    height: int
    masked: bool
    kept: Kept

    @classmethod
    def of(cls, path: Path, mask: Path | None, kept: Kept) -> "PictureFile":
        """A picture from its headers. Raises ValueError, with the file, for headers that are damaged or don't agree."""
        width, height, channels = image_size(path)
        if mask is not None and (size := image_size(mask)[:2]) != (width, height):
            raise ValueError(_another_size(mask, size, path, (width, height)))
        return cls(path, mask, width, height, mask is not None or channels == 4, kept)

    def without_alpha(self) -> "PictureFile":
        """The same picture without alpha."""
        return dataclasses.replace(self, masked=False)

    def read(self) -> Colors:
        """(linear RGB, alpha or None), which must not be written to. Raises `CannotRead`, with the file."""
        image, alpha = self.kept.get((self.path, self.mask), self._read)
        return image, alpha if self.masked else None

    def _read(self) -> Colors:
        try:
            image, alpha = read_picture(self.path, self.mask)
        except ValueError as problem:
            raise CannotRead(str(problem)) from problem
        except OSError as problem:
            raise CannotRead(f"{self.path}: can't be read ({reason(problem)})") from problem
        if image.shape[:2] != (self.height, self.width) or (self.masked and alpha is None):
            raise CannotRead(f"{self.path}: is another picture than its header said; was it changed meanwhile?")
        for pixels in (image, alpha):
            if pixels is not None:
                pixels.flags.writeable = False  # other callers may get the same array
        return image, alpha


def find_picture(base: Path, name: str, said_by: Path) -> Path:
    """The file of a picture whose name may lack its suffix. Raises ValueError, with the file that names the picture.

    It may be outside of `base`, and it may be a link: photographs are often shared.
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
    raise ValueError(f"{said_by}: names a picture that is missing: {looked}; restore it or take its entry out")


def _is_possible(name: str) -> bool:
    """Whether a name can be that of a file. Systems raise errors for others, which do not say where they are from."""
    try:
        encoded = name.encode()
    except UnicodeEncodeError:
        return False
    longest = max(map(len, encoded.split(b"/")))
    return min(name, default=" ") >= " " and longest <= LONGEST_NAME and len(encoded) <= LONGEST_PATH


def find_mask(folder: Path, name: str) -> Path | None:
    """The mask of a picture: `masks/NAME.png`, or `masks/NAME.jpg.png` as in COLMAP; None without a folder of masks.

    Of a picture that is elsewhere, only the last part of its name counts. Raises ValueError if there are masks, but
    none for this picture.
    """
    masks = folder / "masks"
    if not masks.is_dir():
        return None
    relative = Path(name)
    if relative.is_absolute() or ".." in relative.parts:
        relative = Path(relative.name)  # else the picture could be its own mask
    for candidate in (masks / relative.with_suffix(".png"), masks / f"{relative}.png"):
        if candidate.is_file():
            return candidate
    raise ValueError(f"{masks}: there is no mask for {name}; add {candidate.name}, or take the folder away")


def check_masks_have_pictures(folder: Path, used: set[Path]) -> None:
    """Raises ValueError for masks that belong to no picture."""
    masks = folder / "masks"
    if masks.is_dir() and (left := sorted(set(masks.rglob("*.png")) - used)):
        more = f" and {len(left) - 1} more" if len(left) > 1 else ""
        raise ValueError(f"{left[0]}{more}: a mask without a photograph; add the photograph or take the mask away")


def read_picture(path: Path, mask: Path | None) -> Colors:
    """(linear RGB, not multiplied by alpha; alpha from the mask, or from the file, or None).

    EXR files hold colours multiplied by alpha; other files do not. Raises ValueError, with the file, for a file that
    can't be read, a mask of another size, and a mask or alpha that is empty.
    """
    pixels = load_image(path)
    if not np.isfinite(pixels).all():
        raise ValueError(f"{path}: has pixels that are not finite; write it anew without NaN and infinity")
    color, alpha = pixels[..., :3], pixels[..., 3] if pixels.shape[2] == 4 else None
    color = np.repeat(color, 3, axis=2) if color.shape[2] == 1 else color
    if alpha is not None:
        alpha = np.clip(alpha, 0.0, 1.0)
        if path.suffix.lower() == ".exr":
            color = color / np.where(alpha > 0, alpha, 1.0)[..., None]
    source = path
    if mask is not None:
        source, values = mask, load_image(mask, raw=True)
        # The alpha of a mask that has one counts, not its colour.
        alpha = values[..., -1] if values.shape[2] == 4 else values[..., 0]
        if alpha.shape != color.shape[:2]:
            raise ValueError(_another_size(mask, alpha.shape[::-1], path, color.shape[1::-1]))
    if alpha is not None and not (alpha > 0.5).any():
        raise ValueError(f"{source}: the mask is empty, the object is nowhere; take this photograph out")
    return np.ascontiguousarray(color, np.float32), None if alpha is None else np.ascontiguousarray(alpha, np.float32)


def _another_size(mask: Path, size, path: Path, wanted) -> str:
    sizes = [f"{width} x {height}" for width, height in (size, wanted)]
    return f"{mask}: the mask has {sizes[0]} pixels, {path.name} has {sizes[1]}; resize it"
