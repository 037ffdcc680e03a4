"""Lamps of many faces: clusters and chords across them against closed forms, and the default against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import sphere
from tests.gradients.floor_point import (
    LIGHT,
    QUADRANGLE,
    RADIANCE,
    estimates,
    exact,
    mean_and_error,
    scene,
    sheet,
)
from tests.gradients.test_line_sampling import LIGHTS, SHIELD, WALL
from tests.stability.shadows import HIGH, SHADE
from tests.stability.stage import camera, cube, table

SIDES = 3  # cells along the sides of a light: 18 faces


def grid() -> tuple[np.ndarray, np.ndarray]:
    """(weights [V, 4] of a light's corners in the vertices of its cells, faces [F, 3])."""
    s = np.arange(SIDES + 1) / SIDES
    a, b = (x.ravel() for x in np.meshgrid(s, s, indexing="ij"))
    index = np.arange((SIDES + 1) ** 2).reshape(SIDES + 1, SIDES + 1)
    v00, v10, v11, v01 = (x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([v00, v10, v11], 1), np.stack([v00, v11, v01], 1)])
    return np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], 1), faces


CASES = {
    "small": (sheet(QUADRANGLE, 0.1), LIGHTS["small"]),  # some clusters of it are split and some are not
    "far": (sheet(QUADRANGLE * [1.0, 1.0, 4.0], 0.1), LIGHT * [1.0, 1.0, 6.0]),  # it is one cluster
    "tiny": (sheet(QUADRANGLE * [0.04, 0.04, 1.0], 0.1), LIGHT * [0.04, 0.04, 1.0]),  # seen under 5 degrees
    "very large": (sheet(QUADRANGLE, 0.1), LIGHTS["very large"]),  # all around clusters' spheres
    "wall": (sheet(SHIELD, 0.1), WALL),  # lobes find as much
}


@pytest.mark.parametrize(
    "name, max_depth",
    [
        ("small", 3),
        ("far", 3),
        ("tiny", 3),
        pytest.param("very large", 3, marks=pytest.mark.slow),
        ("wall", 3),
        pytest.param("small", 2, marks=pytest.mark.slow),
        pytest.param("very large", 2, marks=pytest.mark.slow),
    ],
)
def test_a_light_in_pieces_is_the_closed_form(name, max_depth):
    """At depth 3 chords around BSDF samples find the light as well, at depth 2 those across clusters alone."""
    blocker, light = CASES[name]
    value, truth = exact(blocker, light)
    weights, faces = grid()
    whole = scene(blocker, light=light)
    pieces = jd.Shape(jd.Mesh(weights @ light, faces), jd.Diffuse(0.0), jd.AreaEmitter(RADIANCE))
    of = jd.Scene({**whole.shapes, "light": pieces}, whole.camera)
    radiance, rows = estimates(of, jd.LineSampling(), sampling="mis", max_depth=max_depth)
    mean, deviation = mean_and_error(radiance)
    assert abs(mean - value) < 0.002 * value + 4 * deviation, f"radiance is off: {mean} ± {deviation}, exactly {value}"
    rows["light.vertices"] = np.einsum("vc,kvi->kci", weights, rows["light.vertices"])
    largest = np.abs(truth["blocker.vertices"]).max()
    for parameter, true in truth.items():
        scale = max(np.abs(true).max(), largest)
        mean, deviation = (x / scale for x in mean_and_error(rows[parameter]))
        assert deviation.max() < 0.05, f"{parameter}: too few samples, ± {deviation.max():.3f}"
        wrong = np.abs(mean - true / scale) > 0.002 + 4 * deviation
        assert not wrong.any(), f"{parameter} is off:\n{mean}\n± {deviation}, exactly\n{true / scale}"


@pytest.mark.slow
def test_the_default_under_a_tiny_mesh_agrees_with_differences():
    """1,280 faces: `KernelDensity` finds nine tenths of this shadow's derivative."""
    step, positions, calls = 0.02, 8, 256
    of = table(cube(at=HIGH), light=sphere(3, radius=0.008, center=(0.9, -0.5, 2.4)), view=camera(*SHADE, 45.0))
    still = of.parameters()["blocker.vertices"]
    velocity = jnp.asarray([1.0, 0.4, 0.2])

    def at(t, key, spp, **options):
        return jd.render(of.replace({"blocker.vertices": still + t * velocity}), key, spp, **options)

    plain = jd.jit(lambda t, key: at(t, key, 512, integrator=jd.PathTracer(2, None)))
    derivative = jd.jit(lambda t, key: jax.jvp(lambda t: at(t, key, 64), (t,), (jnp.ones(()),))[1])
    truth = np.zeros((16, 16, 3))
    for key in jax.random.split(jax.random.key(1), 64):
        truth += (np.asarray(plain(step, key), float) - np.asarray(plain(-step, key), float)) / (2 * step * 64)
    shares = []
    for number in range(calls):
        t = step * (2.0 * (number % positions + 0.5) / positions - 1.0)
        image = np.asarray(derivative(t, jax.random.fold_in(jax.random.key(2), number)), float)
        shares.append((image * truth).sum() / (truth**2).sum())
    mean, error = np.mean(shares), np.std(shares, ddof=1) / np.sqrt(calls)
    assert error < 0.04 and abs(mean - 1.0) < 0.02 + 3 * error, f"{mean} ± {error}"
