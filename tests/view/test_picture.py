"""`jd.Picture`: images and derivatives as notebooks show them."""

from io import BytesIO

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxdr as jd

RNG = np.random.default_rng(0)


def png(picture: jd.Picture) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(picture._repr_png_())).convert("RGB"))


def test_an_image_is_srgb_with_square_pixels(capsys):
    image = jnp.array([[[0.0, 0.5, 1.0], [2.0, -1.0, 0.2]]] * 2)
    picture = jd.Picture(image, height=8)
    expected = np.array([[0, 188, 255], [255, 0, 124]], np.uint8).repeat(4, 0)
    assert picture.pixels.shape == (8, 8, 3)
    np.testing.assert_array_equal(picture.pixels, np.broadcast_to(expected, (8, 8, 3)))
    np.testing.assert_array_equal(png(picture), picture.pixels)
    assert capsys.readouterr() == ("", "")
    assert repr(picture) == "jaxdr.Picture of 8 x 8 pixels"


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 1)])
def test_one_channel_is_grey(shape):
    pixels = jd.Picture(RNG.random(shape, np.float32), height=1).pixels
    assert pixels.shape == (4, 5, 3) and (pixels == pixels[..., :1]).all()


def test_signed_images_are_red_and_blue_and_share_their_limit():
    one = np.array([[1.0, -1.0, 0.0]])
    both = jd.Picture([one, 4 * one], signed=True, height=1, columns=1).pixels
    weak, strong = both[0, :3], both[len(both) // 2 + 4, :3]  # a row of 96 pixels has room for the bar
    assert strong[0].tolist() == [180, 4, 38] and strong[1].tolist() == [59, 76, 192]
    assert weak[0].tolist() == [230, 186, 195] and weak[1].tolist() == [200, 204, 233]
    assert (weak[2] == 247).all() and (strong[2] == 247).all()


def test_noise_does_not_set_the_limit_and_one_may_be_given():
    image = np.ones((40, 40))
    image[0, 0] = 1e6
    assert jd.Picture(image, signed=True, height=1).pixels[1, 1].tolist() == [180, 4, 38]
    assert jd.Picture(image, signed=True, limit=1e3, height=1).pixels[1, 1].min() > 240
    assert jd.Picture(np.zeros((4, 4)), signed=True).pixels[1, 1].tolist() == [247, 247, 247]
    one = np.zeros((100, 100))
    one[5, 5] = 1.0
    assert jd.Picture(one, signed=True, height=1).pixels[5, 5].tolist() == [180, 4, 38]


def test_nan_is_seen():
    image = np.zeros((2, 2, 3), np.float32)
    image[0, 1, 2] = np.nan
    for signed in (False, True):
        pixels = jd.Picture(image, signed=signed, height=2).pixels
        assert pixels[0, 1].tolist() == [255, 0, 255] and pixels[1, 1].tolist() != [255, 0, 255]


def test_images_are_in_rows_below_their_titles():
    images = RNG.random((5, 4, 4, 3)).astype(np.float32)
    plain = jd.Picture(images, height=40, columns=3).pixels
    assert plain.shape == (88, 136, 3)
    titled = jd.Picture(jnp.asarray(images), [f"image {i}" for i in range(5)], height=40, columns=3).pixels
    assert titled.shape[0] == 88 + 2 * 22 and titled.shape[1] >= 136
    assert titled[:22].min() < 128  # letters


def test_images_of_any_sizes():
    sizes = jd.Picture([np.ones((4, 4, 3)), np.ones((8, 2))], height=8).pixels
    assert sizes.shape == (8, 8 + 8 + 2, 3)


@pytest.mark.parametrize(
    "given, message",
    [
        ({"images": []}, "there is no image"),
        ({"images": np.ones(3)}, r"got \[3\]"),
        ({"images": np.ones((2, 2, 4))}, r"got \[2, 2, 4\]"),
        ({"images": np.ones((0, 2, 3))}, "each of images must have shape"),
        ({"images": np.ones((2, 2)), "titles": ["a", "b"]}, "2 titles for 1 images"),
        ({"images": np.ones((2, 2)), "signed": [True, False]}, "2 signed for 1 images"),
        ({"images": np.ones((2, 2)), "signed": True, "limit": 0.0}, "limit must be positive"),
        ({"images": np.ones((2, 2)), "height": 0}, "height must be a positive whole number"),
        ({"images": np.ones((2, 2)), "columns": 0}, "columns must be a positive whole number"),
    ],
)
def test_mistakes_are_told(given, message):
    with pytest.raises(ValueError, match=message):
        jd.Picture(**given)


def test_traced_images_are_refused():
    with pytest.raises(ValueError, match="traced"):
        jax.jit(lambda x: jd.Picture(x).pixels.sum() * x)(jnp.ones((2, 2)))
