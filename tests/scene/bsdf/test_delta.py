"""Delta lobes: directions, energy, Snell's law, reversibility, derivatives, and how often they are chosen."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from tests.scene.bsdf.checks import QUICK, call, check_derivatives, direction, random_directions, repeated, uniform

COLOUR = (0.2, 0.5, 0.8)
MODELS = {
    "mirror": jd.Conductor(specular_reflectance=COLOUR),
    "gold": jd.Conductor("Au"),
    "glass": jd.Dielectric(1.5, 1.0, specular_transmittance=COLOUR),
    "bubble": jd.Dielectric(1.0, "water"),
    "pane": jd.ThinDielectric(1.5, 1.0),
    "plastic": jd.Plastic(COLOUR),
    "mask": jd.Mask(0.3, jd.Diffuse(COLOUR)),
    "masked plastic": jd.Mask(0.7, jd.Plastic(COLOUR)),
    "masked glass": jd.Mask(0.7, jd.Dielectric(1.5, 1.0)),
}
models = pytest.mark.parametrize("name", MODELS)


def lobes(bsdf, wi, count=4096):
    """The delta lobes of one direction: {direction: (weight, probability)}, and how often each is chosen."""
    u = jnp.stack([(jnp.arange(count) + 0.5) / count, jnp.full(count, 0.5)], -1)
    sample = call(bsdf, "sample_delta", repeated(wi, count), u)
    chosen = sample.probability > 0
    found = {}
    for wo, weight, probability in zip(*(x[chosen] for x in sample), strict=True):
        key = tuple(np.round(wo, 4) + 0.0)
        found.setdefault(key, [weight, probability, 0.0])[2] += 1 / count
    return found


@models
def test_lobes_are_chosen_as_often_as_they_say(name):
    bsdf = MODELS[name]
    for theta in (0.1, 0.5, 1.3, 1.9, 2.8):
        found = lobes(bsdf, direction(theta, 0.3))
        for wo, (weight, probability, frequency) in found.items():
            assert abs(np.linalg.norm(wo) - 1) < 2e-4
            assert np.all(weight >= 0)
            assert abs(frequency - probability) < 1e-3
        if isinstance(bsdf, jd.Conductor | jd.Plastic) and theta > np.pi / 2:
            assert not found


@models
def test_nothing_else_is_chosen_with_the_rest(name):
    """Delta models have no density; the others' density integrates to the rest (`test_models.py`)."""
    bsdf = MODELS[name]
    wi, wo = random_directions(50, 0), random_directions(50, 1)
    only_delta = isinstance(bsdf, jd.Conductor | jd.Dielectric | jd.ThinDielectric) or name == "masked glass"
    assert bsdf.delta
    assert np.any(call(bsdf, "pdf", wi, wo) > 0) != only_delta
    assert np.any(call(bsdf, "eval", wi, wo) > 0) != only_delta


def test_no_model_without_delta_lobes_chooses_any():
    for bsdf in (jd.Diffuse(), jd.RoughConductor(), jd.RoughDielectric(), jd.RoughPlastic(), jd.Principled()):
        assert not bsdf.delta
        assert not np.any(bsdf.sample_delta(random_directions(5, 0), uniform(5, 0)).probability)


def test_glass():
    """Snell, energy with the squared ratio of indices taken out, total internal reflection."""
    glass, eta = jd.Dielectric(1.5, 1.0), 1.5
    for theta in (0.0, 0.4, 1.2, 2.0, 2.6, 3.0):
        wi = direction(theta, 0.3)
        relative = eta if theta < np.pi / 2 else 1 / eta
        found = lobes(glass, wi)
        total = np.zeros(3)
        for wo, (weight, _, _) in found.items():
            if np.sign(wo[2]) == np.sign(wi[2]):
                np.testing.assert_allclose(wo, wi * [-1, -1, 1], atol=1e-4)
                total += weight
            else:
                np.testing.assert_allclose(np.multiply(wo[:2], relative), -wi[:2], atol=3e-4)
                total += weight * relative**2
        np.testing.assert_allclose(total, 1.0, rtol=1e-4)
        assert len(found) == (1 if theta == 2.0 else 2)
    np.testing.assert_allclose(lobes(glass, direction(0, 0))[(0.0, 0.0, 1.0)][0], 0.04, rtol=1e-4)


def test_refraction_is_reversible():
    """The ray that arrives along the refracted one leaves along wi, with the same weight but for the indices."""
    glass = jd.Dielectric(1.5, 1.0)
    wi = random_directions(100, 3)
    u = jnp.tile(jnp.asarray([[1 - 2**-20, 0.5]]), (100, 1))
    there = call(glass, "sample_delta", wi, u)
    refracted = there.wo[:, 2] * np.asarray(wi)[:, 2] < 0
    back = call(glass, "sample_delta", there.wo, u)
    np.testing.assert_allclose(back.wo[refracted], np.asarray(wi)[refracted], atol=1e-4)
    np.testing.assert_allclose((back.weight * there.weight)[refracted, 0], (back.probability**2)[refracted], rtol=1e-3)
    assert refracted.sum() > 50


def test_pane_and_mask():
    pane = lobes(jd.ThinDielectric(1.5, 1.0), direction(0.0, 0.0))
    np.testing.assert_allclose(pane[(0.0, 0.0, 1.0)][0], 2 * 0.04 / 1.04, rtol=1e-4)
    np.testing.assert_allclose(pane[(0.0, 0.0, -1.0)][0], 1 - 2 * 0.04 / 1.04, rtol=1e-4)
    for theta in (0.5, 2.5):
        wi = direction(theta, 0.3)
        inside = lobes(jd.Dielectric(1.5, 1.0), wi)
        masked = lobes(MODELS["masked glass"], wi)
        through = masked.pop(tuple(np.round(-wi.astype(np.float32), 4) + 0.0))
        np.testing.assert_allclose(through[0], 0.3, rtol=1e-4)
        for wo, (weight, probability, _) in masked.items():
            np.testing.assert_allclose(weight, 0.7 * inside[wo][0], rtol=1e-4)
            np.testing.assert_allclose(probability, 0.7 * inside[wo][1], rtol=1e-4)


@models
def test_derivatives(name):
    """Direction and weight in wi and in every field, against central differences in float64; the choice is held."""
    with jax.enable_x64(True):
        bsdf = MODELS[name]
        if name == "mirror":  # its eta of zero is the end of a range, where differences have one side
            bsdf = jd.Conductor("Au", specular_reflectance=COLOUR)
        bsdf = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), bsdf)
        wi = jnp.asarray(np.asarray(random_directions(30, 4)), jnp.float64)
        wi = wi[jnp.abs(wi[:, 2]) > 0.1]
        # The first number chooses the one lobe or the other.
        u = jnp.repeat(jnp.asarray([[0.005, 0.5], [0.999, 0.5]]), wi.shape[0], 0)

        def lobe(bsdf, wi):
            return jnp.concatenate(bsdf.sample_delta(wi, u)[:2], -1)

        check_derivatives(lobe, (bsdf, jnp.concatenate([wi, wi])), atol=1e-6)


@models
def test_finite_gradients(name):
    """At the pole, at grazing angles, where total internal reflection begins, from behind."""
    critical = np.arcsin(1 / 1.5)
    angles = [0.0, 1e-4, np.pi / 2, np.pi / 2 - 1e-4, critical, np.pi - critical, np.pi]
    wi = jnp.asarray(direction(angles, 0.0), float)

    def total(bsdf, wi, u):
        sample = bsdf.sample_delta(wi, u)
        return sample.wo.sum() + sample.weight.sum()

    u = jnp.asarray([[first, 0.5] for first in (0.0, 0.5, 1 - 2**-24) for _ in angles])
    gradients = jax.jit(jax.grad(total, (0, 1)), compiler_options=QUICK)(MODELS[name], jnp.tile(wi, (3, 1)), u)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradients))
