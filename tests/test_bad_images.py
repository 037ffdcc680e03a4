"""Damaged and hostile pictures: one error that names the file, at once, and without the memory that they claim."""

import contextlib
import io
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from PIL import EpsImagePlugin, Image

from jaxdr.image_formats import exr
from jaxdr.images import image_size, load_image, write_image
from jaxdr.scene.textures import Bitmap
from jaxdr.untrusted import MOST_PIXELS

HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
NPY = {"descr": "<f4", "fortran_order": False, "shape": (2, 2, 3)}


def png(width, height, pixels=b"", kind=2, chunks=()):
    """A PNG of 8 bits with these bytes as its pixels."""
    size = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    parts = [(b"IHDR", size), *chunks, (b"IDAT", zlib.compress(pixels)), (b"IEND", b"")]
    packed = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in parts]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def encoded(name, size=(16, 16)):
    data = io.BytesIO()
    Image.effect_noise(size, 50).convert("RGB").save(data, name)
    return data.getvalue()


def jpeg(width, height):
    data = encoded("JPEG")
    at = data.index(b"\xff\xc0") + 5
    return data[:at] + struct.pack(">HH", height, width) + data[at + 4 :]


def bmp(width, height, compression=0, bits=24):
    return (
        b"BM"
        + struct.pack("<IHHIIiiHHIIiiII", 200, 0, 0, 54, 40, width, height, 1, bits, compression, *[0] * 5)
        + bytes(150)
    )


def tga(width, height, kind=2):
    return struct.pack("<BBBHHBHHHHBB", 0, 0, kind, 0, 0, 0, 0, 0, width, height, 24, 0) + bytes(100)


def npy(header, data=bytes(48), version=1):
    text = header if isinstance(header, bytes) else repr(NPY | header).encode()
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(text)) + text + data


def archive():
    data = io.BytesIO()
    np.savez(data, a=np.zeros((2, 2, 3)))
    return data.getvalue()


TEXT = zlib.compress(b"a" * 200_000_000, 1)
CLAIMS = {
    "a.png": png(11_000, 11_000),
    "huge.png": png(40_000, 40_000),
    "most.png": png(2**31 - 1, 2**31 - 1),
    "empty.png": png(0, 4),
    "text.png": png(4, 4, bytes(52), chunks=[(b"zTXt", b"a\0\0" + TEXT)]),
    "profile.png": png(4, 4, bytes(52), chunks=[(b"iCCP", b"a\0\0" + TEXT)]),
    "a.jpg": jpeg(11_000, 11_000),
    "huge.jpg": jpeg(65_535, 65_535),
    "a.bmp": bmp(11_000, 11_000),
    "runs.bmp": bmp(11_000, 11_000, 1, 8),
    "negative.bmp": bmp(11, -(2**31)),
    "a.tga": tga(11_000, 11_000),
    "runs.tga": tga(11_000, 11_000, 10),
    "huge.tga": tga(65_535, 65_535),
    "a.hdr": HDR + b"-Y 11000 +X 11000\n" + bytes(100),
    "huge.hdr": HDR + b"-Y 99999999 +X 99999999\n" + bytes(100),
    "digits.hdr": HDR + b"-Y " + b"1" * 9000 + b" +X 8\n" + bytes(100),
    "a.pfm": b"PF\n11000 11000\n-1\n" + bytes(99),
    "huge.pfm": b"PF\n999999999 999999999\n-1\n" + bytes(99),
    "digits.pfm": b"PF\n" + b"1" * 9000 + b" 1\n-1\n" + bytes(99),
    "empty.pfm": b"PF\n0 5\n-1\n",
    "a.npy": npy({"shape": (10**30, 1, 3)}),
    "big.npy": npy({"shape": (11_000, 11_000, 3)}),
    "negative.npy": npy({"shape": (-2, -2, 3)}),
    "empty.npy": npy({"shape": (0, 2, 3)}),
    "archive.npy": archive(),
    "header.npy": npy(b"{'descr': '<f4', 'fortran_order': False, 'shape': (2, "),
    "code.npy": npy(b"__import__('os').abort()"),
    "deep.npy": npy(b"(" * 5000),
    "objects.npy": npy({"descr": "|O"}),
    "text.npy": npy({"descr": "<U1"}),
    "complex.npy": npy({"descr": "<c8"}, bytes(96)),
    "version.npy": npy({}, version=9),
}


@pytest.fixture
def peak_memory():
    """A context in which Python and NumPy may take so many MiB at most."""

    @contextlib.contextmanager
    def limited(most):
        tracemalloc.start()
        try:
            yield
            assert tracemalloc.get_traced_memory()[1] < most << 20
        finally:
            tracemalloc.stop()

    return limited


@pytest.mark.parametrize("name", CLAIMS)
def test_a_picture_that_claims_what_it_does_not_hold(tmp_path, name, peak_memory):
    path = tmp_path / name
    path.write_bytes(CLAIMS[name])
    with peak_memory(150), pytest.raises(ValueError) as caught:
        load_image(path)
    assert str(caught.value).startswith(f"{path}: ") and len(str(caught.value)) < 600


EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.bmp", "a.tga"])
@pytest.mark.parametrize("data", [EPS, encoded("GIF"), encoded("TIFF"), encoded("PPM"), b"\0" * 40])
def test_only_the_formats_that_are_documented_are_opened(tmp_path, monkeypatch, name, data):
    """Pillow runs Ghostscript for EPS."""
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: pytest.fail("a program was started"))
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: pytest.fail("a program was started"))
    path = tmp_path / name
    path.write_bytes(data)
    for reader in (load_image, image_size):
        with pytest.raises(ValueError, match=rf"{name}: not a readable"):
            reader(path)


def test_bytes_without_a_signature_are_tga_by_name_only(tmp_path):
    for name in ("a.tga", "a.png"):
        (tmp_path / name).write_bytes(encoded("TGA"))
    assert load_image(tmp_path / "a.tga").shape == (16, 16, 3)
    with pytest.raises(ValueError, match=r"a\.png: not a readable PNG or JPEG or BMP file"):
        load_image(tmp_path / "a.png")


@pytest.mark.parametrize("deep", [False, True])
def test_every_byte_of_a_png_counts(tmp_path, deep):
    """No changed byte gives other pixels: Pillow alone looks at no check sum of the pixels."""
    path = tmp_path / "a.png"
    pixels = np.random.default_rng(0).integers(0, 256, (3, 4), np.uint8)
    Image.fromarray(pixels.astype(np.uint16) * 257 if deep else pixels).save(path)
    data, right = path.read_bytes(), load_image(path)
    for at in range(len(data)):
        path.write_bytes(data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :])
        try:
            found = load_image(path)
        except ValueError as error:
            assert str(path) in str(error)
        else:
            np.testing.assert_array_equal(found, right)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.bmp", "a.hdr", "a.pfm", "a.npy", "a.exr", "a.tga"])
def test_a_picture_that_is_cut_off_anywhere(tmp_path, name):
    path = tmp_path / name
    if name.endswith((".hdr", ".pfm", ".npy", ".exr")):
        if name == "a.exr" and not exr.is_available():
            pytest.skip("OpenEXR is not installed")
        write_image(path, np.random.default_rng(0).random((5, 9, 3)).astype(np.float32))
    else:
        path.write_bytes(encoded({"jpg": "JPEG"}.get(name[2:], name[2:].upper())))
    data = path.read_bytes()
    footer = {"a.tga": 26, "a.jpg": 2}.get(name, 0)  # after the pixels; Pillow does not ask for them
    for length in range(0, len(data) - footer, 7):
        path.write_bytes(data[:length])
        with pytest.raises(ValueError, match=rf"{name}: "):
            load_image(path)


def test_bytes_after_the_last_row_of_an_hdr_file_are_told(tmp_path):
    path = tmp_path / "a.hdr"
    write_image(path, np.ones((3, 9, 3), np.float32))
    path.write_bytes(path.read_bytes().replace(b"-Y 3", b"-Y 2"))
    with pytest.warns(UserWarning, match=r"a\.hdr: the \d+ bytes after the last of its 2 rows are left out"):
        assert load_image(path).shape == (2, 9, 3)


def test_values_that_are_too_large(tmp_path):
    np.save(tmp_path / "a.npy", np.full((2, 2, 3), 1e300))
    (tmp_path / "a.pfm").write_bytes(b"Pf\n1 1\n-1e30\n" + struct.pack("<f", 1e30))
    for name in ("a.npy", "a.pfm"):
        with pytest.raises(ValueError, match=rf"{name}: .* too large"):
            load_image(tmp_path / name)
    (tmp_path / "b.pfm").write_bytes(b"Pf\n1 1\n1e99\n" + bytes(4))
    with pytest.raises(ValueError, match=r"b\.pfm: the scale must not be"):
        load_image(tmp_path / "b.pfm")


@pytest.mark.parametrize("suffix", ["npy", "pfm", "exr"])
def test_pixels_that_are_not_finite(tmp_path, suffix):
    """Files may hold them, for instance as marks. A texture may not, and names the file."""
    if suffix == "exr" and not exr.is_available():
        pytest.skip("OpenEXR is not installed")
    image = np.ones((3, 4, 3), np.float32)
    image[1, 2] = np.nan
    path = tmp_path / f"a.{suffix}"
    write_image(path, image)
    np.testing.assert_array_equal(load_image(path), image)
    with pytest.raises(ValueError, match=rf"a\.{suffix}: pixels are not finite, the first in row 1, column 2"):
        Bitmap.from_file(path)


def test_an_exr_file_with_too_many_pixels_or_channels(tmp_path, monkeypatch):
    OpenEXR = pytest.importorskip("OpenEXR")
    path, values = tmp_path / "a.exr", np.zeros((4, 4), np.float32)
    OpenEXR.File({}, {f"layer{i}.X": values for i in range(99)} | {"Y": values}).write(str(path))
    assert load_image(path).shape == (4, 4, 1)
    monkeypatch.setattr(exr, "MOST_VALUES", 1000)
    with pytest.raises(ValueError, match=r"a\.exr: all its channels have 1600 values; at most 1000 are read"):
        load_image(path)
    data = path.read_bytes()
    for size in (1 << 14, 1 << 20):
        at = data.index(b"dataWindow\0box2i\0") + 21
        path.write_bytes(data[:at] + struct.pack("<4i", 0, 0, size - 1, size - 1) + data[at + 16 :])
        with pytest.raises(ValueError, match=r"a\.exr: (expected 1 to|not a readable EXR file)"):
            load_image(path)


def test_sizes_are_limited_before_pixels_are_read(tmp_path):
    path = tmp_path / "a.pfm"
    with path.open("wb") as file:
        file.write(b"Pf\n20000 20000\n-1\n")
    for reader in (load_image, image_size):
        with pytest.raises(ValueError, match=rf"a\.pfm: expected 1 to {MOST_PIXELS} pixels, got 20000 x 20000"):
            reader(path)
