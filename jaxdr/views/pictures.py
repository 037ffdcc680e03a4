"""The pictures of a folder of photographs: files found, colours and masks read."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.images import READERS, load_image

Picture = tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"] | None]


def find_picture(base: Path, name: str, said_by: Path) -> Path:
    """The file of a picture, whose name may lack its suffix. Raises ValueError that names who asked for it."""
    path = base / name
    if path.suffix.lower() in READERS:
        candidates = [path]
    else:
        candidates = [path.with_name(path.name + suffix) for suffix in READERS]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    looked = candidates[0] if len(candidates) == 1 else f"{path} with any of {', '.join(READERS)}"
    raise ValueError(f"{said_by}: names a picture that is missing: {looked}; restore it or take its entry out")


def find_mask(folder: Path, name: str) -> Path | None:
    """The mask of a picture: `masks/NAME.png`, or `masks/NAME.jpg.png` as COLMAP has them; None without the folder.

    Raises ValueError where there are masks and none for this picture.
    """
    masks = folder / "masks"
    if not masks.is_dir():
        return None
    relative = Path(name)
    for candidate in (masks / relative.with_suffix(".png"), masks / f"{relative}.png"):
        if candidate.is_file():
            return candidate
    raise ValueError(f"{masks}: there is no mask for {name}; add {candidate.name}, or take the folder away")


def check_masks_have_pictures(folder: Path, used: set[Path]) -> None:
    """Raise ValueError for masks that belong to no picture."""
    masks = folder / "masks"
    if masks.is_dir() and (left := sorted(set(masks.rglob("*.png")) - used)):
        more = f" and {len(left) - 1} more" if len(left) > 1 else ""
        raise ValueError(f"{left[0]}{more}: a mask without a photograph; add the photograph or take the mask away")


def read_picture(path: Path, mask: Path | None) -> Picture:
    """Linear RGB, not multiplied by alpha, and alpha from the mask, else from the file, else None.

    EXR files hold colours multiplied by alpha, the others do not. Raises ValueError that names the file for one that
    can't be read, a mask of another size, and a mask or alpha without any object.
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
        # The last channel of grey and alpha, or of RGB and alpha, is what a mask with alpha says.
        alpha = values[..., -1] if values.shape[2] == 4 else values[..., 0]
        if alpha.shape != color.shape[:2]:
            raise ValueError(f"{mask}: the mask has {_size(alpha)} pixels, {path.name} has {_size(color)}; resize it")
    if alpha is not None and not (alpha > 0.5).any():
        raise ValueError(f"{source}: the mask is empty, the object is nowhere; take this photograph out")
    return np.ascontiguousarray(color, np.float32), None if alpha is None else np.ascontiguousarray(alpha, np.float32)


def _size(pixels: np.ndarray) -> str:
    return f"{pixels.shape[1]} x {pixels.shape[0]}"
