"""Chords and strips around what rough glass samples add up to line integrals of its BSDF, on both sides of it."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.kernel_density.lobe_kernel import _kernel
from jaxdr.boundary.line_sampling.chords import lobe_chords, lobe_rate, lobe_weight
from jaxdr.geometry.vector import dot, normalize
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point
from jaxdr.transport.shading import Scatterer

COUNT = 100_000
# View direction, pole of the great circle that is the boundary, roughness. Circles run through both hemispheres.
CASES = {
    "steep": ([0.2, 0.1, 0.9], [0.9, 0.1, 0.3], 0.3),
    "oblique": ([0.8, 0.0, 0.5], [0.2, 1.0, 0.1], 0.5),
    "from inside": ([0.5, 0.1, -0.8], [0.9, 0.2, -0.4], 0.3),
    "total reflection": ([0.9, 0.0, -0.4], [0.1, 1.0, 0.3], 0.5),
}


def at_a_point(case, count):
    view, pole, alpha = CASES[case]
    floor = jd.Mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]])
    camera = jd.Perspective(jd.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]), 40.0, jd.Film(4, 4))
    glass = jd.RoughDielectric(alpha, 1.5, 1.0)
    packed = pack(jd.Scene({"floor": jd.Shape(floor, glass)}, camera, jd.ConstantEnvironment(1.0)))
    zero = jnp.zeros(count, jnp.int32)
    point = material_point(packed, zero, jnp.full((count, 3), 1 / 3), jnp.ones(count, bool))
    wi = np.asarray(view) / np.linalg.norm(view)
    pole = np.asarray(pole) / np.linalg.norm(pole)
    return Scatterer(packed, point, jnp.broadcast_to(jnp.asarray(wi, jnp.float32), (count, 3))), pole


def line_integral(case, values, count=20_000):
    """Of f_s |cos| along the great circle, of `values` there."""
    scatterer, pole = at_a_point(case, count)
    s = np.cross(pole, [0.0, 0.0, 1.0])
    s /= np.linalg.norm(s)
    angle = (np.arange(count) + 0.5) * 2 * np.pi / count
    circle = np.cos(angle)[:, None] * s + np.sin(angle)[:, None] * np.cross(pole, s)
    return np.asarray(values(scatterer, jnp.asarray(circle, jnp.float32))).mean() * 2 * np.pi


def check(found, exact, within=0.02):
    mean, error = found.mean(), found.std(ddof=1) / math.sqrt(len(found))
    assert error < within * exact, f"too few samples: {mean} ± {error}, exactly {exact}"
    assert abs(mean - exact) < 4 * error, f"{mean} ± {error}, exactly {exact}"


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("width", [pytest.param(0.1, marks=pytest.mark.slow), 0.8])
def test_chords(case, width):
    """Every chord crosses the circle once or twice; weights times f add up to the line integral of f."""
    scatterer, pole = at_a_point(case, COUNT)
    lobes = lobe_chords(scatterer, jnp.full(COUNT, width), jax.random.uniform(jax.random.key(1), (COUNT, 3)))
    meets = jnp.cross(lobes.plane, jnp.asarray(pole, jnp.float32))
    total = rates = jnp.zeros(COUNT)
    for sign in (1.0, -1.0):
        boundary = sign * normalize(meets)
        near = dot(boundary, lobes.centre) > math.cos(width)
        value = scatterer.eval(boundary)[:, 0]
        total += jnp.where(near, lobe_weight(scatterer, lobes, boundary) * value, 0.0)
        rate = lobe_rate(scatterer, lobes.reach, lobes.plane, boundary)
        rates += jnp.where(near & (value > 0), value * lobe_weight(scatterer, lobes, boundary) * (rate > 0), 0.0)
    exact = line_integral(case, lambda s, w: s.eval(w)[:, 0])
    check(np.asarray(total, float), exact, 0.03)
    np.testing.assert_allclose(rates.mean(), total.mean(), rtol=1e-5)


def test_rims_are_needed(monkeypatch):
    """With the horizon for the only bound, what the kernel gives to directions that are never sampled is lost."""
    monkeypatch.setattr(jd.RoughDielectric, "rims", jd.Diffuse.rims)
    with pytest.raises(AssertionError, match="exactly"):
        test_strips("oblique", 0.7)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("limit", [pytest.param(0.1, marks=pytest.mark.slow), 0.7])
def test_strips(case, limit):
    """A kernel over the angle to the circle, around the directions that are sampled."""
    scatterer, pole = at_a_point(case, COUNT)
    u = jax.random.uniform(jax.random.key(2), (COUNT, 2))
    centre = scatterer.sample(u)
    pdf = scatterer.sampled_pdf(centre, u)
    axis = jnp.asarray(pole, jnp.float32)
    foot = normalize(centre - (centre @ axis)[:, None] * axis)
    kernel, counts = _kernel(scatterer, centre, foot, jnp.broadcast_to(axis, centre.shape), jnp.full(COUNT, limit))
    found = jnp.where(counts & (pdf > 0), kernel / jnp.where(pdf > 0, pdf, 1.0) * scatterer.eval(foot)[:, 0], 0.0)
    check(np.asarray(found, float), line_integral(case, lambda s, w: s.eval(w)[:, 0]), 0.03)
