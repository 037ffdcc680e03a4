"""Environment maps: look-up, density and sampler on their own; tests/transport has what they light."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import jaxdr as jd
from tests.scene.bsdf.checks import QUICK, check_derivatives, direction, random_directions, uniform

TURN = np.eye(4)
TURN[:3, :3] = Rotation.from_euler("xyz", [0.4, -0.7, 1.9]).as_matrix()
MIRROR = TURN @ np.diag([-2.0, 2.0, 2.0, 1.0])
SIZES = {"small": (3, 2), "even": (8, 16), "odd": (7, 5)}


def pixels(size, contrast=1.0, seed=0):
    rng = np.random.default_rng(seed)
    values = rng.exponential(size=(*SIZES[size], 3))
    values[rng.integers(SIZES[size][0]), rng.integers(SIZES[size][1])] *= contrast
    values[[0, -1]] = values[[0, -1], :1]  # all columns meet at the poles
    return values


def expected(image, to_world, directions):
    """The look-up in plain NumPy and double precision, as the module's docstring puts it."""
    height, width, _ = image.shape
    d = np.asarray(directions, float) @ np.linalg.inv(to_world[:3, :3]).T
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    x = np.arctan2(d[:, 0], -d[:, 2]) / (2 * np.pi) * width - 0.5
    y = np.arccos(d[:, 1]) / np.pi * (height - 1)
    i, j = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), height - 2)
    a, b = (x - i)[:, None], (y - j)[:, None]
    rows = [(1 - a) * image[k, i % width] + a * image[k, (i + 1) % width] for k in (j, j + 1)]
    return (1 - b) * rows[0] + b * rows[1]


@pytest.mark.parametrize("to_world", [np.eye(4), TURN, MIRROR], ids=["", "turned", "mirrored"])
@pytest.mark.parametrize("size", SIZES)
def test_bilinear_look_up(size, to_world):
    image, directions = pixels(size), random_directions(500, 1)
    found = jd.EnvironmentMap(image, to_world, 0.5).eval(directions)
    np.testing.assert_allclose(found, 0.5 * expected(image, to_world, directions), rtol=2e-5, atol=2e-5)


def test_axes_and_poles():
    """Up is the first row, the middle column is +z, the quarter -x; at the poles and across the seam it is defined."""
    image = np.zeros((5, 8, 3))
    image[0], image[-1] = (1, 0, 0), (0, 1, 0)
    image[2] = np.arange(8)[:, None]
    sky = jd.EnvironmentMap(image)
    axes = jnp.asarray([[0, 1, 0], [0, -1, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 0, -1], [0, 0, 0]], float)
    found = sky.eval(axes)
    np.testing.assert_allclose(found[:2], [[1, 0, 0], [0, 1, 0]], atol=1e-6)
    np.testing.assert_allclose(found[2:6, 0], [3.5, 1.5, 5.5, 3.5], atol=1e-5)
    slopes = jax.jit(lambda d: jax.grad(lambda d: sky.eval(d).sum() + sky.sampler().pdf(d).sum())(d))(axes)
    assert np.all(np.isfinite(found)) and np.all(np.isfinite(slopes))


@cache
def compiled(method):
    return jax.jit(lambda sky, x: getattr(sky.sampler(), method)(x), compiler_options=QUICK)


def cell_masses(sky, rows, columns, fine):
    """Integral of the density over cells even in polar angle and azimuth around +z."""
    theta = (np.arange(rows * fine) + 0.5) / (rows * fine) * np.pi
    phi = (np.arange(columns * fine) + 0.5) / (columns * fine) * 2 * np.pi
    area = 2 * np.sin(theta) * np.sin(0.5 * np.pi / (rows * fine)) * 2 * np.pi / (columns * fine)
    grid = direction(*np.meshgrid(theta, phi, indexing="ij")).reshape(-1, 3)
    density = np.asarray(compiled("pdf")(sky, jnp.asarray(grid, float)), float).reshape(rows * fine, columns * fine)
    return (density * area[:, None]).reshape(rows, fine, columns, fine).sum((1, 3))


@pytest.mark.parametrize("size, contrast", [("small", 1.0), ("even", 1.0), ("even", 1e4), ("odd", 30.0)])
@pytest.mark.parametrize("to_world", [np.eye(4), MIRROR], ids=["", "mirrored"])
def test_density_is_that_of_the_samples(size, contrast, to_world):
    """Chi², and the integral is one."""
    sky = jd.EnvironmentMap(pixels(size, contrast), to_world, 3.0)
    count, (rows, columns) = 100_000, (16, 32)
    samples = np.asarray(compiled("sample")(sky, uniform(count, 2)), float)
    np.testing.assert_allclose(np.linalg.norm(samples, axis=1), 1.0, rtol=1e-5)
    masses = cell_masses(sky, rows, columns, 24)
    assert abs(masses.sum() - 1) < 2e-3
    row = np.minimum(np.arccos(np.clip(samples[:, 2], -1, 1)) / np.pi * rows, rows - 1).astype(int)
    column = np.minimum(np.arctan2(samples[:, 1], samples[:, 0]) / (2 * np.pi) % 1 * columns, columns - 1).astype(int)
    observed = np.bincount(row * columns + column, minlength=rows * columns)
    probable = count * masses.ravel() / masses.sum()
    rare = probable < 10
    observed, probable = (np.array([*x[~rare], x[rare].sum()]) for x in (observed, probable))
    used = probable > 10
    statistic = np.sum((observed - probable)[used] ** 2 / probable[used])
    assert statistic < chi2.ppf(1 - 1e-5, used.sum() - 1), (statistic, used.sum())


def test_density_follows_the_radiance():
    """Radiance over density is bounded; even over the sphere for one colour, or none at all."""
    image = pixels("even", 100.0)
    image[2, 3] = 0.0
    sky = jd.EnvironmentMap(image, TURN)
    directions = random_directions(5000, 4)
    luminance = np.asarray(sky.eval(directions)) @ [0.2126, 0.7152, 0.0722]
    density = compiled("pdf")(sky, directions)
    ratio = luminance / density
    assert np.all(density > 0) and np.max(ratio) < 2 * np.mean(luminance) * 4 * np.pi
    assert np.corrcoef(luminance, density)[0, 1] > 0.9
    for value in (0.0, 2.0):
        even = jd.EnvironmentMap(np.full((8, 16, 3), value))
        np.testing.assert_allclose(compiled("pdf")(even, directions), 1 / (4 * np.pi), rtol=1e-4)


def test_density_is_comparable_within_the_extent():
    """A quarter of the highest in the cell at least; half a texel where the map is rough, more where it is even."""
    image = np.ones((17, 32, 3))
    image[8, 9] = 1e4
    sky = jd.EnvironmentMap(image, TURN)
    around, away = random_directions(4000, 6), random_directions(4000, 7)
    extent = np.asarray(compiled("extent")(sky, around))
    angle = np.minimum(np.random.default_rng(8).uniform(size=4000) * extent, np.pi)[:, None]
    across = np.cross(around, away)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    beside = jnp.asarray(np.cos(angle) * around + np.sin(angle) * across, float)
    one, two = (np.asarray(compiled("pdf")(sky, d)) for d in (around, beside))
    rough = extent < 0.51 * np.pi / 16
    assert rough.any() and np.ptp(extent) > 0.3
    assert np.all((two > 0.2 * one)[~rough])


def test_derivatives():
    """In texels, rotation, scale and direction."""
    with jax.enable_x64(True):
        d = jnp.asarray(direction([0.3, 1.1, 2.0, 2.9], [0.2, 2.0, -1.0, -2.9]))
        moves = check_derivatives(lambda sky, d: sky.eval(d), (jd.EnvironmentMap(pixels("even"), TURN, 0.7), d))
        assert all(moves)
        sampler = jd.EnvironmentMap(pixels("even"), TURN).sampler()
        assert check_derivatives(lambda d: sampler.pdf(d), (d,)) == [True]


def test_what_it_is_made_of():
    image = np.ones((4, 8, 3))
    skewed = np.diag([1.0, 2.0, 1.0, 1.0])
    for arguments, message in (
        ((np.ones((4, 8)),), "must be"),
        ((np.ones((2, 8, 3)),), "H >= 3"),
        ((image, np.eye(3)), "4 x 4"),
        ((image, skewed), "must not skew"),
        ((image, None, [1.0, 2.0]), "scale must be a number"),
    ):
        with pytest.raises(ValueError, match=f"EnvironmentMap: .*{message}"):
            jd.EnvironmentMap(*arguments)


def test_look_up_as_in_mitsuba():
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        image = pixels("even", 50.0).astype(np.float32)
        transform = mi.ScalarTransform4f(TURN)
        bitmap = mi.Bitmap(image)
        theirs = mi.load_dict({"type": "envmap", "bitmap": bitmap, "to_world": transform, "scale": 0.5})
        ours = jd.EnvironmentMap(image, TURN, 0.5)
        directions = random_directions(40, 5)
        for d, radiance in zip(np.asarray(directions), np.asarray(ours.eval(directions)), strict=True):
            si = mi.SurfaceInteraction3f()
            si.wi = -d
            np.testing.assert_allclose(radiance, theirs.eval(si), rtol=1e-3)
    finally:
        if before is not None:
            mi.set_variant(before)
