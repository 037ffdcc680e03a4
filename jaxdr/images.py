"""Image files (PNG, EXR, NPY), tone mapping, and pictures of signed values with a colour bar."""

import os
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

SUFFIXES = (".png", ".exr", ".npy")

# Ends and middle of the diverging map, sRGB: blue, white, red of Moreland 2009, "Diverging Color Maps for Scientific
# Visualization", with a lighter middle so that zero reads as empty.
NEGATIVE, ZERO, POSITIVE = np.array([[59, 76, 192], [247, 247, 247], [180, 4, 38]]) / 255


def to_srgb(image: Float[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
    """8-bit sRGB of linear RGB; what is outside [0, 1] is clipped, for display only (IEC 61966-2-1)."""
    linear = np.clip(image, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255 * encoded).astype(np.uint8)


def diverging(values: Float[np.ndarray, "H W"], limit: float) -> UInt8[np.ndarray, "H W 3"]:
    """8-bit colours of signed values: blue at -limit and below, white at 0, red at +limit and above."""
    t = np.clip(values / limit, -1.0, 1.0)[..., None]
    return np.round(255 * (ZERO + np.where(t < 0, -t * (NEGATIVE - ZERO), t * (POSITIVE - ZERO)))).astype(np.uint8)


def check_image_path(path: Path) -> None:
    """Raise ValueError unless `write_image` could write to `path`: known suffix, existing folder, EXR support."""
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{path}: unknown image format {path.suffix!r}; known are {', '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: folder {path.parent} does not exist")
    if path.suffix.lower() == ".exr" and not has_openexr():
        raise ValueError(f'{path}: EXR files need OpenEXR, which is optional: pip install "jaxdr[experiments]"')


def has_openexr() -> bool:
    """Whether the optional package OpenEXR is installed."""
    try:
        import OpenEXR  # noqa: F401
    except ImportError:
        return False
    return True


def write_image(path: Path, image: Float[np.ndarray, "H W 3"]) -> None:
    """Write linear RGB as `.npy` or `.exr` (float32, unchanged) or `.png` (sRGB, 8 bit).

    The file appears complete or not at all. Raises ValueError as `check_image_path` does.
    """
    check_image_path(path)
    suffix = path.suffix.lower()
    if suffix == ".png":
        save_png(path, to_srgb(image))
    elif suffix == ".npy":
        with atomic_path(path) as temporary:
            np.save(temporary, np.asarray(image, np.float32))
    else:
        import OpenEXR

        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with atomic_path(path) as temporary:
            with OpenEXR.File(header, {"RGB": np.ascontiguousarray(image, np.float32)}) as file:
                file.write(str(temporary))


def save_png(path: Path, pixels: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write 8-bit sRGB pixels; the file appears complete or not at all."""
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG")


class atomic_path:
    """Context manager: a temporary path beside `path` that takes its place when the block ends without an error."""

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self) -> Path:
        with NamedTemporaryFile(dir=self.path.parent, suffix=self.path.suffix, prefix=".", delete=False) as file:
            self.temporary = Path(file.name)
        return self.temporary

    def __exit__(self, kind, value, traceback) -> None:
        if kind is None:
            self.temporary.chmod(0o666 & ~_umask())
            os.replace(self.temporary, self.path)
        else:
            self.temporary.unlink(missing_ok=True)


def signed_picture(values: Float[np.ndarray, "H W"], limit: float, height: int = 512) -> UInt8[np.ndarray, "h w 3"]:
    """Picture of signed values, enlarged to about `height` pixels, with a colour bar labelled ±limit.

    Pixels stay sharp squares: the enlargement is by a whole number. Raises ValueError unless limit > 0.
    """
    if not limit > 0:
        raise ValueError(f"signed_picture: limit must be positive, got {limit}")
    factor = max(1, height // values.shape[0])
    picture = diverging(values, limit).repeat(factor, 0).repeat(factor, 1)

    rows = max(len(picture), 96)  # room for the labels beside a small picture
    canvas = np.full((rows, picture.shape[1] + 112, 3), 255, np.uint8)
    canvas[: len(picture), : picture.shape[1]] = picture
    left, top, bottom = picture.shape[1] + 12, 10, rows - 10
    ramp = np.linspace(limit, -limit, bottom - top)[:, None].repeat(18, 1)
    canvas[top:bottom, left : left + 18] = diverging(ramp, limit)

    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    draw.rectangle((left - 1, top - 1, left + 18, bottom), outline=(90, 90, 90))
    for share in (1.0, 0.5, 0.0, -0.5, -1.0):
        y = top + (1 - share) / 2 * (bottom - top - 1)
        text = f"{share * limit:+.3g}" if share else "0"
        draw.text((left + 24, y), text, fill=(0, 0, 0), font=ImageFont.load_default(12), anchor="lm")
    return np.asarray(image)


def labelled_grid(
    titles: list[str], rows: list[list[UInt8[np.ndarray, "H W 3"]]], gap: int = 4
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures of equal size in rows and columns on white, with a title over each column."""
    height, width = rows[0][0].shape[:2]
    factor = max(1, 128 // height)
    cell_height, cell_width, header = factor * height, factor * width, 18
    size = (header + len(rows) * (cell_height + gap), len(titles) * (cell_width + gap) - gap, 3)
    canvas = np.full(size, 255, np.uint8)
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            y, x = header + i * (cell_height + gap), j * (cell_width + gap)
            canvas[y : y + cell_height, x : x + cell_width] = cell.repeat(factor, 0).repeat(factor, 1)
    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    for j, title in enumerate(titles):
        place = (j * (cell_width + gap) + cell_width // 2, header // 2)
        draw.text(place, title, fill=(0, 0, 0), font=ImageFont.load_default(12), anchor="mm")
    return np.asarray(image)


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
