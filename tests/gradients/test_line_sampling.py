"""Line sampling against exact numbers: a floor point under a polygonal light, small or very large, or under a panel."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients.floor_point import (
    BOOMERANG,
    BOX,
    HALF_PLANE,
    LIGHT,
    QUADRANGLE,
    arrowhead,
    check_derivatives,
    estimates,
    exact,
    mean_and_error,
    scene,
    sheet,
)
from tests.gradients.test_indirect_shadow import check_under_a_panel

LINES = jd.LineSampling()
# A light that the blocker's shadow just fits in, and one above the camera that covers most of the sky.
# A light that is a wall, and a quadrangle before it.
WALL = np.array([[-0.9, -2.5, -0.5], [-0.9, 2.5, -0.5], [-0.85, 2.5, 4.0], [-0.85, -2.5, 4.0]])
SHIELD = np.array([[-0.35, -0.3, 0.6], [-0.3, -0.25, 0.2], [-0.38, 0.25, 0.25], [-0.3, 0.3, 0.55]])
LIGHTS = {"small": LIGHT * [0.7, 0.7, 1.0], "very large": LIGHT * [20.0, 20.0, 2.5]}


@pytest.mark.parametrize(
    "corners",
    [
        pytest.param(HALF_PLANE, id="half plane", marks=pytest.mark.slow),
        pytest.param(QUADRANGLE, id="quadrangle", marks=pytest.mark.slow),
        pytest.param(BOOMERANG, id="boomerang", marks=pytest.mark.slow),
    ],
)
def test_every_derivative_is_the_closed_form(corners):
    """Blocker, light and floor move: apex, edge and receiver. No bias is allowed for."""
    check_derivatives(sheet(corners, 0.1), LINES, tolerance=0.001, sampling="mis")


def test_both_kinds_of_chords():
    """A light seen at a slant, found by chords on it and around BSDF-sampled directions (every surface else is black).

    One kind's angles between chord and boundary are not the other's: shares by themselves would not add up.
    """
    check_derivatives(sheet(SHIELD, 0.1), LINES, tolerance=0.001, light=WALL, sampling="mis", max_depth=3)


@pytest.mark.slow
def test_closed_blocker():
    check_derivatives(BOX, LINES, tolerance=0.001)


@pytest.mark.slow
def test_hidden_and_concave_edges():
    """What other parts of the blocker hide does not count, however near it is."""
    check_derivatives(arrowhead(concave=0.02, hidden=0.02), LINES, tolerance=0.002)


@pytest.mark.slow
def test_float64():
    with jax.enable_x64(True):
        check_derivatives(sheet(QUADRANGLE, 0.1), LINES, tolerance=0.001)


@pytest.mark.slow
def test_plain_queries():
    """Without Warp."""
    check_derivatives(sheet(HALF_PLANE, 0.1), LINES, tolerance=0.002, rays="jax", spp=16)


@pytest.mark.slow
@pytest.mark.parametrize("size, chords, most_keys", [("small", 1.0, 400), ("very large", 8.0, 144)])
def test_no_bias_floor(size, chords, most_keys):
    """The error falls as 1/√N down to 1e-4 of the derivative, and nothing else is left."""
    blocker, lamp, lines = sheet(QUADRANGLE, 0.1), LIGHTS[size], jd.LineSampling(chords=chords)
    truth = exact(blocker, lamp)[1]["blocker.vertices"]
    scale = np.max(np.abs(truth))
    errors = {}
    for spp, keys in ((2, 48), (128, 48), (128, most_keys)):
        rows = estimates(scene(blocker, light=lamp), lines, keys, spp=spp)[1]["blocker.vertices"] / scale
        mean, deviation = mean_and_error(rows)
        assert np.all(np.abs(mean - truth / scale) < 4.5 * deviation + 3e-5), (size, spp, keys)
        errors[spp, keys] = np.sqrt(np.mean(deviation**2)), np.sqrt(np.mean((mean - truth / scale) ** 2))
    (few, _), (many, _), (most, left) = errors.values()
    assert most < 1e-4 and left < 1e-4, errors
    # 64 times the samples: 8 times less noise. The lattice of the chords fits some numbers of chords better.
    assert 5 < few / many and 0.7 < many / most / (most_keys / 48) ** 0.5 < 1.4, errors


@pytest.mark.slow
def test_light_from_a_surface():
    """The same derivative where the light is a lit panel: geodesic chords, and paths from what they find behind."""
    check_under_a_panel(sheet(QUADRANGLE, 0.1), jd.LineSampling(chords=0.25, capacity=4.0))


@pytest.mark.slow
def test_a_light_of_many_triangles():
    """Chords stay within a triangle; the derivative is the same."""
    n = 6
    s = np.linspace(0, 1, n + 1)
    a, b = np.meshgrid(s, s, indexing="ij")
    points = LIGHT[0] + a.reshape(-1, 1) * (LIGHT[1] - LIGHT[0]) + b.reshape(-1, 1) * (LIGHT[3] - LIGHT[0])
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    v00, v10, v01, v11 = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel()
    mesh = jd.Mesh(points, np.concatenate([np.stack([v00, v10, v11], 1), np.stack([v00, v11, v01], 1)]))
    blocker = sheet(QUADRANGLE, 0.1)
    of = scene(blocker)
    of = jd.Scene(
        shapes=dict(of.shapes) | {"light": jd.Shape(mesh, of.shapes["light"].bsdf, of.shapes["light"].emitter)},
        camera=of.camera,
    )
    truth = exact(blocker)[1]["blocker.vertices"]
    scale = np.max(np.abs(truth))
    mean, deviation = mean_and_error(estimates(of, LINES)[1]["blocker.vertices"] / scale)
    assert np.max(deviation) < 0.01
    assert np.all(np.abs(mean - truth / scale) < 4.5 * deviation + 0.001)
