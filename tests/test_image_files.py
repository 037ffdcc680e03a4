"""Image files: round trips, bytes written by hand, what other programs make of them, damaged files."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from jaxdr.images import from_srgb, load_image, to_srgb, write_image

RNG = np.random.default_rng(0)
WIDTHS = [1, 7, 8, 40, 300]  # RGBE run-length encodes from 8 on; runs and literals are cut at 127 and 128


@pytest.fixture(params=WIDTHS)
def image(request):
    """Random radiances over ten orders of magnitude, with long runs of equal pixels and black ones."""
    values = 10 ** RNG.uniform(-5, 5, (5, request.param, 1)) * RNG.random((5, request.param, 3))
    values[1] = values[1, :1]
    values[2, request.param // 3 :] = 0
    return values.astype(np.float32)


@pytest.mark.parametrize("suffix", [".pfm", ".npy", ".exr"])
def test_float_formats_keep_every_bit(tmp_path, image, suffix):
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    write_image(tmp_path / f"a{suffix}", image - 1)  # negative ones, too
    loaded = load_image(str(tmp_path / f"a{suffix}"))
    assert loaded.dtype == np.float32
    np.testing.assert_array_equal(loaded, image - 1)


def test_rgbe_keeps_eight_bits(tmp_path, image):
    write_image(tmp_path / "a.hdr", image)
    loaded = load_image(tmp_path / "a.hdr")
    assert (np.abs(loaded - image) <= image.max(-1, keepdims=True) / 255).all()
    write_image(tmp_path / "b.hdr", loaded)  # what it can hold it keeps
    np.testing.assert_array_equal(load_image(tmp_path / "b.hdr"), loaded)


def test_rgbe_runs_are_short(tmp_path):
    write_image(tmp_path / "a.hdr", np.full((4, 1000, 3), 0.5, np.float32))
    assert (tmp_path / "a.hdr").stat().st_size < 400  # 16,000 bytes flat


HDR = b"#?RADIANCE\n# by hand\nFORMAT=32-bit_rle_rgbe\n\n"


def test_rgbe_by_hand(tmp_path):
    """Flat and run-length encoded rows in one file: 128 · 2^(129 - 136) = 1."""
    flat = bytes([128, 64, 0, 129] * 8)
    runs = b"\2\2\0\10" + bytes([136, 128]) + bytes([134, 64, 2, 1, 2]) + bytes([136, 0]) + bytes([136, 130])
    (tmp_path / "a.hdr").write_bytes(HDR + b"-Y 3 +X 8\n" + flat + runs + flat)
    expected = np.tile(np.array([1, 0.5, 0], np.float32), (3, 8, 1))
    expected[1] = [2, 1, 0]
    expected[1, 6:, 1] = [1 / 64, 2 / 64]
    np.testing.assert_array_equal(load_image(tmp_path / "a.hdr"), expected)


def test_exposure_of_a_radiance_file_warns(tmp_path):
    (tmp_path / "a.hdr").write_bytes(HDR.replace(b"# by hand", b"EXPOSURE=2.5") + b"-Y 1 +X 1\n" + bytes([128] * 4))
    with pytest.warns(UserWarning, match=r"a\.hdr: EXPOSURE=2.5: values are taken as stored"):
        np.testing.assert_array_equal(load_image(tmp_path / "a.hdr"), 0.5)


@pytest.mark.parametrize("order, scale", [("<", "-2"), (">", "2.0")])
def test_pfm_by_hand(tmp_path, order, scale):
    data = struct.pack(f"{order}4f", 1, 2, 3, 4)
    (tmp_path / "a.pfm").write_bytes(f"Pf\n2 2\n{scale}\n".encode() + data)
    np.testing.assert_array_equal(load_image(tmp_path / "a.pfm")[..., 0], [[6, 8], [2, 4]])  # bottom row first


def png_bytes(pixels, sub_filter=False):
    """A PNG of unsigned integers [H, W, C], rows unfiltered or as differences to the pixel on the left."""
    height, width, channels = pixels.shape
    depth, kind = 8 * pixels.itemsize, {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(height, -1).view(np.uint8)
    if sub_filter:
        step = channels * pixels.itemsize
        rows = np.concatenate([rows[:, :step], rows[:, step:] - rows[:, :-step]], 1)
    packed = zlib.compress(b"".join(bytes([sub_filter]) + row.tobytes() for row in rows))
    size = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    chunks = [(b"IHDR", size), (b"IDAT", packed), (b"IEND", b"")]
    parts = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize("sub_filter", [False, True])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_png_of_8_and_16_bits(tmp_path, kind, channels, sub_filter):
    top = np.iinfo(kind).max
    pixels = RNG.integers(0, top, (6, 9, channels), kind, endpoint=True)
    (tmp_path / "a.png").write_bytes(png_bytes(pixels, sub_filter))
    stored = pixels.astype(np.float32) / top
    np.testing.assert_allclose(load_image(tmp_path / "a.png", raw=True), stored, rtol=1e-6)
    loaded = load_image(tmp_path / "a.png")
    np.testing.assert_allclose(loaded[..., :3], from_srgb(stored[..., :3]), rtol=1e-6)
    np.testing.assert_array_equal(loaded[..., 3:], stored[..., 3:])  # alpha is no colour


def test_png_round_trip_is_within_one_step(tmp_path):
    image = RNG.random((5, 6, 3)).astype(np.float32)
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(to_srgb(load_image(tmp_path / "a.png")), to_srgb(image))


def test_srgb_decoding_of_known_values():
    np.testing.assert_allclose(from_srgb(np.array([0, 0.04045, 0.5, 1])), [0, 0.0031308, 0.2140411, 1], rtol=1e-4)


def test_other_kinds_of_png_and_jpeg(tmp_path):
    grey = Image.fromarray(np.full((4, 4), 51, np.uint8))
    grey.convert("P").save(tmp_path / "palette.png")
    grey.convert("1", dither=Image.Dither.NONE).save(tmp_path / "bits.png")
    grey.convert("LA").save(tmp_path / "alpha.png")
    grey.save(tmp_path / "a.jpg", quality=95)
    np.testing.assert_allclose(load_image(tmp_path / "palette.png", raw=True), np.full((4, 4, 3), 0.2), rtol=1e-6)
    np.testing.assert_array_equal(load_image(tmp_path / "bits.png"), np.zeros((4, 4, 1)))
    np.testing.assert_allclose(load_image(tmp_path / "alpha.png", raw=True)[0, 0], [0.2, 0.2, 0.2, 1], rtol=1e-6)
    np.testing.assert_allclose(load_image(tmp_path / "a.jpg", raw=True), np.full((4, 4, 1), 0.2), atol=0.005)
    grey.convert("RGB").save(tmp_path / "a.bmp")
    np.testing.assert_allclose(load_image(tmp_path / "a.bmp", raw=True), np.full((4, 4, 3), 0.2), atol=0.005)


def test_exr_of_one_layer_and_half_precision(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")
    values = RNG.random((4, 6)).astype(np.float16)
    OpenEXR.File({}, {"Y": values}).write(str(tmp_path / "grey.exr"))
    np.testing.assert_array_equal(load_image(tmp_path / "grey.exr"), values[..., None].astype(np.float32))
    OpenEXR.File({}, {"RGBA": np.stack([values] * 4, -1)}).write(str(tmp_path / "rgba.exr"))
    assert load_image(tmp_path / "rgba.exr").shape == (4, 6, 4)
    OpenEXR.File({}, {"normal.X": values}).write(str(tmp_path / "normal.exr"))
    with pytest.raises(ValueError, match=r"normal\.exr: there is no layer RGBA, RGB, Y; the file has normal\.X"):
        load_image(tmp_path / "normal.exr")


GOOD_RUNS = b"-Y 1 +X 8\n\2\2\0\10" + bytes([2, 9, 9, 134, 9] + [136, 1] * 3)
DAMAGED = {
    "a.pfm": {
        b"": "the header is not that of a PFM file",
        b"PF\n1 1\n0\n" + bytes(12): "the scale must not be 0",
        b"PF\n1 1\n1.0.0\n" + bytes(12): "the scale '1.0.0' is not a number",
        b"PF\n2 1\n-1\n" + bytes(12): "2 x 1 pixels take 24 bytes, the file has 12",
        b"PF\n1 1\n-1\n" + bytes(16): "take 12 bytes, the file has 16",
    },
    "a.hdr": {
        b"hello": "the first line is not that of a Radiance file",
        b"#?RADIANCE\n": "the header has no end",
        HDR.replace(b"rgbe", b"xyze"): "FORMAT=32-bit_rle_xyze is not supported",
        HDR + b"+Y 1 +X 1\n": r"expected a size such as '-Y 512 \+X 1024', got '\+Y 1",
        HDR + b"-Y 9998 +X 9999\n" + bytes(9): "9 bytes are too few for 9999 x 9998 pixels",
        HDR + GOOD_RUNS[:-1]: "row 0 is damaged: its runs are 24 bytes long instead of 32",
        HDR + GOOD_RUNS[:-2] + bytes([137, 1]): "its runs are 33 bytes long",
        HDR + GOOD_RUNS.replace(b"\0\10", b"\0\11"): "row 0 is damaged: it has 9 pixels instead of 8",
        HDR + b"-Y 2 +X 2\n" + bytes([9] * 12): "12 bytes are too few",
        HDR + GOOD_RUNS.replace(b"-Y 1", b"-Y 2") + bytes(12): "the file ends in row 1 of 2",
        HDR + b"-Y 1 +X 2\n" + bytes([9, 9, 9, 9, 1, 1, 1, 9]): "the run-length encoding of before 1991",
    },
    "a.png": {
        b"": "not a readable PNG or JPEG or BMP file",
        png_bytes(np.zeros((9, 9, 3), np.uint16))[:50]: "not a readable PNG file",
        png_bytes(np.zeros((9, 9, 3), np.uint8)).replace(b"IDAT", b"IDOT"): "not a readable PNG or JPEG or BMP file",
        png_bytes(np.zeros((9, 9, 2), np.uint16)): "16-bit grey with alpha .* not supported; use RGBA",
    },
    "a.npy": {b"": "not a readable NPY file", b"\x93NUMPY\x01\x00": ""},
    "a.exr": {b"": "not a readable EXR file", b"v/1\1" + bytes(200): "not a readable EXR file"},
}
CASES = [(name, data, message) for name, cases in DAMAGED.items() for data, message in cases.items()]


@pytest.mark.parametrize("name, data, message", CASES, ids=[f"{n}-{m or len(d)}"[:40] for n, d, m in CASES])
def test_damaged_files_are_one_clear_error(tmp_path, name, data, message):
    if name == "a.exr":
        pytest.importorskip("OpenEXR")
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=rf"{name}: .*{message}"):
        load_image(tmp_path / name)


@pytest.mark.parametrize("damage", ["cut", "overwritten"])
def test_damaged_exr_pixels(tmp_path, damage):
    pytest.importorskip("OpenEXR")
    path = tmp_path / "a.exr"
    write_image(path, RNG.integers(0, 9, (64, 99, 3)).astype(np.float32))
    data = path.read_bytes()
    half = len(data) // 2
    path.write_bytes(data[:half] if damage == "cut" else data[:half] + bytes(99) + data[half + 99 :])
    with pytest.raises(ValueError, match=r"a\.exr: not a readable EXR file"):
        load_image(path)


def test_bad_arguments(tmp_path):
    with pytest.raises(ValueError, match=r"no\.png: there is no such file"):
        load_image(tmp_path / "no.png")
    with pytest.raises(ValueError, match=r"a\.gif: unknown image format '\.gif'; known are \.png, \.jpg"):
        load_image(tmp_path / "a.gif")
    for value in (-1, np.nan, 2.0**127):
        with pytest.raises(ValueError, match=r"a\.hdr: values must be finite and not negative in this format"):
            write_image(tmp_path / "a.hdr", np.full((1, 1, 3), value, np.float32))
    np.save(tmp_path / "flat.npy", np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"flat\.npy: expected an array of shape \[H, W, 1, 3 or 4\], got \[3, 3\]"):
        load_image(tmp_path / "flat.npy")


@pytest.mark.parametrize("name", ["a.hdr", "a.pfm", "a.exr", "a.png"])
def test_files_as_mitsuba_reads_and_writes_them(tmp_path, name):
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        image = np.clip(RNG.random((40, 50, 3)), 0.1, 0.9).astype(np.float32)
        write_image(tmp_path / name, image)
        linear = (mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
        np.testing.assert_allclose(mi.Bitmap(str(tmp_path / name)).convert(*linear), image, rtol=0.05)

        kind, is_srgb = (mi.Struct.Type.UInt16, True) if name == "a.png" else (mi.Struct.Type.Float32, False)
        mi.Bitmap(image).convert(mi.Bitmap.PixelFormat.RGB, kind, is_srgb).write(str(tmp_path / f"their_{name}"))
        rtol = {"a.hdr": 0.05, "a.png": 1e-3}.get(name, 0)
        np.testing.assert_allclose(load_image(tmp_path / f"their_{name}"), image, rtol=rtol)
    finally:
        if before is not None:
            mi.set_variant(before)
