"""Image files and pictures of signed values."""

import sys

import numpy as np
import pytest
from PIL import Image

from jaxdr.atomic_file import atomic_path
from jaxdr.images import diverging, labelled_grid, signed_picture, to_srgb, write_image


@pytest.fixture
def image():
    return np.random.default_rng(0).random((4, 6, 3)).astype(np.float32) * 2 - 0.5


def test_srgb_of_known_values():
    linear = np.array([[[-1.0, 0.0, 0.001], [0.2158605, 0.5, 1.0], [2.0, 0.0031308, 0.7304608]]])
    np.testing.assert_array_equal(to_srgb(linear)[0], [[0, 0, 3], [128, 188, 255], [255, 10, 222]])


def test_npy_and_png(tmp_path, image):
    write_image(tmp_path / "a.npy", image)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), image)
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), to_srgb(image))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npy", "a.png"]


def test_exr_keeps_every_value(tmp_path, image):
    OpenEXR = pytest.importorskip("OpenEXR", reason='EXR is optional: pip install -e ".[exr]"')
    write_image(tmp_path / "a.exr", image)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, image)


def test_missing_openexr_is_named(tmp_path, image, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ValueError, match=r'pip install -e "\.\[exr\]"'):
        write_image(tmp_path / "a.exr", image)


def test_bad_paths(tmp_path, image):
    with pytest.raises(ValueError, match=r"unknown image format '\.jpg'; known are \.png, \.exr, \.hdr, \.pfm, \.npy"):
        write_image(tmp_path / "a.jpg", image)
    with pytest.raises(ValueError, match="nowhere does not exist"):
        write_image(tmp_path / "nowhere/a.png", image)


def test_an_error_while_writing_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


def test_diverging_colours():
    red, white, blue = diverging(np.array([[1.0, 0.0, -1.0]]), 1.0)[0].astype(int)
    assert red[0] > red[2] + 100 and blue[2] > blue[0] + 100
    assert white.min() > 240
    np.testing.assert_array_equal(diverging(np.array([[5.0, -5.0]]), 1.0), diverging(np.array([[1.0, -1.0]]), 1.0))


def test_signed_picture_has_the_values_and_a_bar():
    values = np.array([[2.0, -2.0], [0.0, 1.0]])
    picture = signed_picture(values, 2.0, height=200)
    assert picture.shape[0] == 200 and picture.shape[1] > 220
    np.testing.assert_array_equal(picture[50, [50, 150]], diverging(values, 2.0)[0])
    np.testing.assert_array_equal(picture[150, [50, 150]], diverging(values, 2.0)[1])
    bar = picture[15:185, 200 + 20].astype(int)
    assert bar[0, 0] > bar[0, 2] and bar[-1, 2] > bar[-1, 0]  # red on top
    with pytest.raises(ValueError, match="limit must be positive"):
        signed_picture(values, 0.0)


def test_grid_places_pictures_in_rows():
    cells = [[np.full((128, 128, 3), 40 * (2 * row + column), np.uint8) for column in range(2)] for row in range(3)]
    grid = labelled_grid(["a", "b"], cells)
    assert (grid[18 + 64 + 132 * 2, 64 + 132] == 200).all()
    assert (grid[18 + 64, 64] == 0).all()
