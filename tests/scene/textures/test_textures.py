"""Textures alone: closed-form values and derivatives, wrapping, what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.scene.textures import TexturePoint

H, W = 3, 4
PIXELS = np.random.default_rng(0).uniform(0.1, 0.9, (H, W, 3))
# Where each wrap finds the pixel with an index beyond the image: 0 … 3 repeated, mirrored, or the last one.
WRAPPED = {
    "repeat": lambda i, n: i % n,
    "mirror": lambda i, n: (*range(n), *range(n)[::-1])[i % (2 * n)],
    "clamp": lambda i, n: min(max(i, 0), n - 1),
}


def points(uv, barycentric=None, vertices=None):
    n = len(uv)
    barycentric = np.full((n, 3), 1 / 3) if barycentric is None else barycentric
    vertices = np.zeros((n, 3), int) if vertices is None else vertices
    return TexturePoint(jnp.asarray(uv, float), jnp.asarray(barycentric, float), jnp.asarray(vertices, jnp.int32))


def values(texture, point):
    """Of one texture: stacked with another, as scenes do, whose values must not be met."""
    other = jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan), texture)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), other, texture)
    return stacked.values(jnp.ones(len(point.barycentric), jnp.int32), point)


def bilinear(pixels, u, v, wrap):
    """Weights of the four pixel centres around a point, by hand."""
    x, y = u * W - 0.5, (1 - v) * H - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))
    total = np.zeros(3)
    for row, share_y in ((j, 1 - (y - j)), (j + 1, y - j)):
        for column, share_x in ((i, 1 - (x - i)), (i + 1, x - i)):
            total += share_x * share_y * pixels[WRAPPED[wrap](row, H), WRAPPED[wrap](column, W)]
    return total


UVS = np.random.default_rng(1).uniform(-2.5, 3.5, (200, 2))


@pytest.mark.parametrize("wrap", WRAPPED)
def test_bilinear(wrap):
    expected = [bilinear(PIXELS, u, v, wrap) for u, v in UVS]
    np.testing.assert_allclose(values(jd.Bitmap(PIXELS, wrap=wrap), points(UVS)), expected, atol=2e-6)


@pytest.mark.parametrize("wrap", WRAPPED)
def test_nearest(wrap):
    place = [(int(np.floor((1 - v) * H)), int(np.floor(u * W))) for u, v in UVS]
    expected = [PIXELS[WRAPPED[wrap](i, H), WRAPPED[wrap](j, W)] for i, j in place]
    np.testing.assert_allclose(values(jd.Bitmap(PIXELS, filter="nearest", wrap=wrap), points(UVS)), expected, rtol=1e-6)


def test_centres_and_corners_of_an_image():
    """(0, 0) is the lower left; a pixel's value is at its centre; between two it is their mean."""
    texture = jd.Bitmap(PIXELS, wrap="clamp")
    uv = [[0, 0], [1, 0], [0, 1], [0.5 / W, 1 - 0.5 / H], [2.5 / W, 1 - 1.5 / H], [2 / W, 1 - 1.5 / H]]
    expected = [PIXELS[2, 0], PIXELS[2, 3], PIXELS[0, 0], PIXELS[0, 0], PIXELS[1, 2], PIXELS[1, 1:3].mean(0)]
    np.testing.assert_allclose(values(texture, points(uv)), expected, rtol=1e-5)


@pytest.mark.parametrize("wrap", WRAPPED)
def test_derivatives(wrap):
    """In UVs the slope between centres, in pixels the weights; in float64, away from the kinks."""
    with jax.enable_x64(True):
        texture = jd.Bitmap(PIXELS, wrap=wrap)

        def slopes(uv):
            u, v = jnp.ones((len(uv), 2)) * jnp.array([1.0, 0.0]), jnp.ones((len(uv), 2)) * jnp.array([0.0, 1.0])
            return [
                jax.jvp(lambda x: values(texture, points(UVS)._replace(uv=x)), (uv,), (axis,))[1] for axis in (u, v)
            ]

        found, step = slopes(jnp.asarray(UVS)), 1e-7
        for axis, slope in enumerate(found):
            move = step * np.eye(2)[axis]
            difference = [
                (bilinear(PIXELS, *(uv + move), wrap) - bilinear(PIXELS, *(uv - move), wrap)) / (2 * step) for uv in UVS
            ]
            np.testing.assert_allclose(slope, difference, atol=1e-6)
        assert np.abs(found[0]).max() > 0.5  # 4 pixels a unit: up to 4 times their difference

        weight = np.random.default_rng(2).normal(size=(200, 3))
        loss = jax.grad(lambda t: (weight * values(t, points(UVS))).sum())(texture).pixels
        unit = np.zeros_like(PIXELS)
        for index in ((0, 0, 0), (2, 3, 1), (1, 2, 2)):
            unit[index] = 1
            expected = sum(w @ bilinear(unit, u, v, wrap) for w, (u, v) in zip(weight, UVS, strict=True))
            np.testing.assert_allclose(loss[index], expected, rtol=1e-10)
            unit[index] = 0


def test_continuous_where_it_says_so():
    """Bilinear values have no jumps, at seams of repetition neither; the others do."""
    line = np.linspace(-1.2, 2.3, 70_001)
    uv = points(np.stack([line, 0.3 + 0.01 * line], 1))
    for wrap in WRAPPED:
        jumps = np.abs(np.diff(np.asarray(values(jd.Bitmap(PIXELS, wrap=wrap), uv)), axis=0)).max()
        assert jd.Bitmap(PIXELS, wrap=wrap).continuous and jumps < 1e-3
    for texture in (jd.Bitmap(PIXELS, filter="nearest"), jd.Checkerboard((0.1, 0.2, 0.3), 0.9)):
        assert not texture.continuous and np.abs(np.diff(np.asarray(values(texture, uv)), axis=0)).max() > 0.1


def test_to_uv():
    """Applied before the image is looked up; as good as the UVs that it makes; differentiable."""
    matrix = np.array([[0.5, -1.2, 0.3], [0.8, 0.4, -0.1]])
    moved = UVS @ matrix[:, :2].T + matrix[:, 2]
    for square in (matrix, np.vstack([matrix, [0, 0, 1]])):
        found = values(jd.Bitmap(PIXELS, to_uv=square), points(UVS))
        np.testing.assert_allclose(found, values(jd.Bitmap(PIXELS), points(moved)), atol=1e-5)
        found = values(jd.Checkerboard(0.0, 1.0, to_uv=square), points(UVS))
        np.testing.assert_array_equal(found, values(jd.Checkerboard(0.0, 1.0), points(moved)))

    with jax.enable_x64(True):
        texture = jd.Bitmap(PIXELS, to_uv=matrix)
        move = np.random.default_rng(3).normal(size=(2, 3))

        def total(t):
            changed = jax.tree.map(lambda x: x, texture)
            object.__setattr__(changed, "to_uv", jnp.asarray(matrix) + t * move)
            return values(changed, points(UVS)).sum()

        derivative = jax.jvp(total, (0.0,), (1.0,))[1]
        np.testing.assert_allclose(derivative, (total(1e-7) - total(-1e-7)) / 2e-7, rtol=1e-6)


def test_checkerboard():
    """`color0` at the upper left and lower right of two by two fields."""
    texture = jd.Checkerboard((0.1, 0.2, 0.3), 0.9)
    uv = [[0.2, 0.8], [0.7, 0.2], [0.2, 0.2], [0.7, 0.8], [-0.2, -0.3], [1.2, 0.3]]
    expected = np.where([[True], [True], [False], [False], [False], [False]], [0.1, 0.2, 0.3], 0.9)
    np.testing.assert_allclose(values(texture, points(uv)), expected, rtol=1e-6)
    gradient = jax.grad(lambda t: values(t, points(uv))[:, 0].sum())(texture)
    np.testing.assert_allclose([gradient.color0[0], gradient.color1[0]], [2, 4])


def test_vertex_colors():
    colors = np.random.default_rng(4).uniform(size=(5, 3))
    weights = np.random.default_rng(5).dirichlet(np.ones(3), 20)
    corners = np.random.default_rng(6).integers(0, 5, (20, 3))
    expected = (colors[corners] * weights[..., None]).sum(1)
    found = values(jd.VertexColors(colors), points(np.zeros((20, 2)), weights, corners)._replace(uv=None))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_products():
    """An image times colours of vertices, and their derivatives; an image times numbers is times grey."""
    rng = np.random.default_rng(7)
    colors, weights, corners = rng.uniform(size=(5, 3)), rng.dirichlet(np.ones(3), 200), rng.integers(0, 5, (200, 3))
    at = points(UVS, weights, corners)
    image, of_vertices, grey = jd.Bitmap(PIXELS), jd.VertexColors(colors), jd.Bitmap(PIXELS[..., 0])
    expected = np.asarray(values(image, at)) * np.asarray(values(of_vertices, at))
    np.testing.assert_allclose(values(jd.Product(image, of_vertices), at), expected, rtol=1e-5)
    np.testing.assert_allclose(
        values(jd.Product(image, of_vertices).times([0.5, 1, 2]), at), expected * [0.5, 1, 2], 1e-5
    )
    tinted = jd.Diffuse(jd.Product(of_vertices, grey)).reflectance
    np.testing.assert_allclose(
        values(tinted, at), np.asarray(values(of_vertices, at)) * np.asarray(values(grey, at))[:, None], rtol=1e-5
    )
    slope = jax.grad(lambda t: values(t, at).sum())(jd.Product(image, of_vertices))
    np.testing.assert_allclose(slope.second.colors.sum(), (np.asarray(values(image, at))).sum(), rtol=1e-5)
    with pytest.raises(ValueError, match=r"metallic must be in .* from 0 to 4"):
        jd.Principled(metallic=jd.Product(jd.Bitmap([[0.0, 2.0]]), jd.VertexColors([0.5, 2.0])))
    low, high = jd.Product(jd.Bitmap([[-1.0, 2.0]]), jd.VertexColors([-3.0, 1.0])).extremes()
    assert (low[0], high[0]) == (-6, 3)


def test_numbers_and_colours():
    """One channel gives numbers; as a colour it becomes grey; a colour can't be a number."""
    number = jd.Bitmap(PIXELS[..., 0])
    assert number.pixels.shape == (H, W, 1) and values(number, points(UVS)).shape == (200,)
    assert jd.Diffuse(number).reflectance.pixels.shape == (H, W, 3)
    assert jd.Principled(roughness=number).roughness is number
    assert jd.Diffuse(jd.VertexColors(np.ones(4))).reflectance.colors.shape == (4, 3)
    assert jd.Checkerboard(0.1, (1.0, 0.5, 0.2)).color0.shape == (3,)
    with pytest.raises(ValueError, match=r"RoughConductor: alpha must be a number at every point.* RGB"):
        jd.RoughConductor(jd.Bitmap(PIXELS))


def test_every_field_takes_a_texture():
    grey, rgb = jd.Bitmap(0.5 * np.ones((2, 2))), jd.Bitmap(PIXELS)
    for bsdf in (
        jd.Diffuse(rgb), jd.RoughConductor(grey, eta=rgb, k=grey, specular_reflectance=rgb),
        jd.Conductor(eta=rgb, k=rgb, specular_reflectance=rgb), jd.Plastic(rgb, specular_reflectance=rgb),
        jd.Dielectric(specular_reflectance=rgb, specular_transmittance=rgb), jd.Mask(grey, jd.Diffuse(rgb)),
        jd.ThinDielectric(specular_reflectance=rgb), jd.RoughPlastic(rgb, grey, specular_reflectance=rgb),
        jd.RoughDielectric(grey, specular_reflectance=rgb, specular_transmittance=rgb),
        jd.Principled(rgb, grey, grey, grey), jd.TwoSided(jd.Diffuse(rgb)),
    ):  # fmt: skip
        assert any(leaf.ndim > 1 for leaf in jax.tree.leaves(bsdf))


WRONG = [
    (lambda: jd.Bitmap(np.zeros((2, 2, 2))), r"Bitmap: pixels \[H, W, C\] must have 1 or 3 channels .* \(2, 2, 2\)"),
    (lambda: jd.Bitmap(np.zeros(4)), "must have 1 or 3 channels at 2 indices"),
    (lambda: jd.Bitmap(np.zeros((2, 2), np.uint8)), "must be floats, linear, got uint8"),
    (lambda: jd.Bitmap(PIXELS, filter="cubic"), "filter must be one of bilinear, nearest; got 'cubic'"),
    (lambda: jd.Bitmap(PIXELS, wrap="border"), "wrap must be one of repeat, mirror, clamp; got 'border'"),
    (lambda: jd.Bitmap(PIXELS, to_uv=np.eye(4)), r"to_uv must have shape \[2, 3\] or \[3, 3\], got \[4, 4\]"),
    (lambda: jd.Bitmap(PIXELS, to_uv=np.ones((3, 3))), r"the last row of to_uv must be 0 0 1"),
    (lambda: jd.Checkerboard((0.1, 0.2)), "Checkerboard: color0 must have 1 or 3 channels"),
    (lambda: jd.RoughConductor(jd.Bitmap(np.zeros((2, 2)))), r"alpha must be in \[0.0001, 1\].* from 0 to 0"),
    (lambda: jd.Principled(jd.Bitmap(2 * PIXELS)), r"base_color must be in \[0, 1\], and the texture has values"),
    (lambda: jd.Diffuse(jd.Bitmap(-PIXELS)), "reflectance must be at least 0, and the texture has values from -0"),
    (lambda: jd.Diffuse(jd.VertexColors([[np.nan] * 3])), r"VertexColors: colors must be finite, got \[\[nan"),
    (lambda: jd.Dielectric(jd.Bitmap(PIXELS)), "int_ior must be a number or a name, not a texture"),
]


@pytest.mark.parametrize(("make", "message"), WRONG)
def test_what_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_from_file(tmp_path):
    """Colours are made linear, raw numbers stay; alpha is dropped or taken alone."""
    stored = np.array([[[0, 64, 128, 255], [255, 32, 16, 0]]], np.uint8)
    Image.fromarray(stored, "RGBA").save(tmp_path / "a.png")
    share = stored / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(jd.Bitmap.from_file(tmp_path / "a.png").pixels, linear[..., :3], rtol=1e-5)
    raw = jd.Bitmap.from_file(tmp_path / "a.png", raw=True, wrap="clamp")
    np.testing.assert_allclose(raw.pixels, share[..., :3], rtol=1e-6)
    assert raw.wrap == "clamp"
    np.testing.assert_allclose(jd.Bitmap.from_file(tmp_path / "a.png", channel=3).pixels, share[..., 3:], rtol=1e-6)
    Image.fromarray(stored[..., 1], "L").save(tmp_path / "grey.png")
    assert jd.Bitmap.from_file(tmp_path / "grey.png").pixels.shape == (1, 2, 1)
    with pytest.raises(ValueError, match=r"grey\.png: there is no channel 3; the image has 1"):
        jd.Bitmap.from_file(tmp_path / "grey.png", channel=3)
    with pytest.raises(ValueError, match=r"no\.png: there is no such file"):
        jd.Bitmap.from_file(tmp_path / "no.png")
