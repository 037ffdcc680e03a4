"""Shadows in light that arrives from a surface, in closed form: a floor point under a panel lit by a far lamp."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients.floor_point import BOX, HALF_PLANE, QUADRANGLE, exact, mean_and_error, scene, sheet
from tests.gradients.lit_panel import lit_panel

NAMES = ("blocker.vertices", "floor.vertices")


@partial(jax.jit, static_argnames="boundary")
def estimate(of, values, key, boundary):
    def radiance(values):
        integrator = jd.PathTracer(max_depth=3, boundary=boundary, edge_samples=0.01)
        return jnp.mean(jd.render(of.replace(values), key, spp=32, integrator=integrator))

    return jax.value_and_grad(radiance)(values)


def estimates(blocker, boundary, keys):
    """Radiance [keys] and derivatives {name: [keys, ...]} for independent keys."""
    of = lit_panel(scene(blocker))
    parameters = of.parameters()
    values = {name: parameters[name] for name in NAMES}
    rows = [jax.device_get(estimate(of, values, key, boundary)) for key in jax.random.split(jax.random.key(1), keys)]
    derivatives = {name: np.stack([row[1][name] for row in rows]).astype(float) for name in NAMES}
    floor = derivatives.pop("floor.vertices")
    return np.array([row[0] for row in rows], float), derivatives | {"floor.height": floor[..., 2].sum(-1)}


def check_under_a_panel(blocker, boundary):
    """Assert radiance and derivatives; errors are relative to the largest entry of the blocker's derivative."""
    value, truth = exact(blocker)
    radiance, rows = estimates(blocker, boundary, keys=8)
    mean, deviation = mean_and_error(radiance)
    assert abs(mean - value) < 0.003 * value + 4 * deviation, f"radiance is off: {mean} ± {deviation}, exactly {value}"
    scale = np.max(np.abs(truth["blocker.vertices"]))
    for name, found in rows.items():
        mean, deviation = (x / scale for x in mean_and_error(found))
        assert np.max(deviation) < 0.03, f"{name}: too few samples, ± {np.max(deviation):.3f}"
        wrong = np.abs(mean - truth[name] / scale) > 0.005 + 4 * deviation
        assert not np.any(wrong), f"{name} is off:\n{mean}\n± {deviation}, exactly\n{truth[name] / scale}"


@pytest.mark.parametrize(
    ("blocker", "radius"),
    [
        pytest.param(sheet(HALF_PLANE, 0.1), 0.03, marks=pytest.mark.slow, id="half plane"),
        pytest.param(sheet(QUADRANGLE, 0.1), 0.3, id="quadrangle"),
        pytest.param(BOX, 0.1, marks=pytest.mark.slow, id="box"),
    ],
)
def test_derivatives_are_the_closed_form(blocker, radius):
    """At any radius."""
    # The sheets' specks blow up their boxes, and with them a radius relative to those.
    size = 1.0 if blocker.closed else np.linalg.norm(np.ptp(np.asarray(blocker.vertices), axis=0))
    check_under_a_panel(blocker, jd.KernelDensity(float(radius / size), capacity=2.0))
