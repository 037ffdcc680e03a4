"""Blends: delta lobes of either, what moves inside, and what light goes through."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.moving import moving_in
from jaxdr.scene.bsdf.base import only_delta, spreads_through
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric
from tests.scene.bsdf.checks import call, direction, repeated, uniform
from tests.scene.bsdf.test_normal_map import CAMERA

HEIGHT = jd.Bitmap(np.ones((2, 2)))


@pytest.mark.parametrize("theta", [0.4, 2.7])
def test_delta_lobes_of_both(theta):
    """Means over u are what both lobes send on, in their shares; inside the mirror is black."""
    glass, count = jd.Dielectric(1.5, 1.0), 16_384
    blend = jd.Blend(0.3, glass, jd.Conductor(specular_reflectance=0.9))
    wi, u = repeated(direction(theta, 0.2), count), uniform(count, 0).at[:, 0].set((jnp.arange(count) + 0.5) / count)
    interface = fresnel_dielectric(jnp.cos(theta), jnp.asarray(1.5))
    reflected, eta_ti = float(interface.reflectance), float(interface.eta_ti)
    mirror = 0.9 if theta < 1.5 else 0.0
    for method, passing in (
        ("sample_delta", eta_ti**2),
        ("adjoint_delta", abs(np.cos(theta)) / float(interface.cos_t)),
    ):
        lobe = call(blend, method, wi, u)
        chosen = lobe.probability > 0
        np.testing.assert_allclose(np.linalg.norm(lobe.wo[chosen], axis=1), 1.0, rtol=1e-5)
        weight = np.where(chosen, lobe.weight[:, 0] / np.where(chosen, lobe.probability, 1), 0)
        expected = 0.7 * (reflected + (1 - reflected) * passing) + 0.3 * mirror
        np.testing.assert_allclose(weight.mean(), expected, rtol=2e-3)


def bends(bsdf, where):
    """Whether the derivative by this field of the BSDF moves what is seen in its shape."""
    scene = jd.Scene({"a": jd.Shape(jd.shapes.rectangle(), bsdf)}, CAMERA)
    still = jax.tree.map(lambda _: False, scene)
    return moving_in(scene, eqx.tree_at(lambda s: where(s.shapes["a"].bsdf), still, True)).shapes == (True,)


def test_what_bends_inside():
    """Fields of nested delta lobes move visibility as those of outer ones do; colours and rough lobes don't."""
    glass, grey = jd.Dielectric(), jd.Diffuse()
    assert bends(jd.Blend(0.5, grey, glass), lambda b: b.second.eta)
    assert bends(jd.Mask(0.5, jd.Blend(0.5, glass, grey)), lambda b: b.bsdf.first.eta)
    assert not bends(jd.Blend(0.5, grey, glass), lambda b: b.second.specular_reflectance)
    assert not bends(jd.Blend(0.5, grey, glass), lambda b: b.weight)
    assert bends(jd.BumpMap(HEIGHT, jd.Conductor()), lambda b: b.height.pixels)
    assert bends(jd.Blend(0.5, jd.BumpMap(HEIGHT, jd.Conductor()), grey), lambda b: b.first.scale)
    assert bends(jd.NormalMap((0.5, 0.5, 1.0), jd.Blend(0.5, grey, jd.Conductor())), lambda b: b.normal)
    assert not bends(jd.BumpMap(HEIGHT, jd.RoughConductor()), lambda b: b.scale)


def test_what_goes_through():
    glass, grey, rough = jd.Dielectric(), jd.Diffuse(), jd.RoughDielectric()
    assert only_delta(jd.Blend(0.5, glass, jd.Conductor())) and not only_delta(jd.Blend(0.5, glass, grey))
    assert spreads_through(jd.Blend(0.5, grey, rough)) and spreads_through(jd.Mask(0.5, rough))
    assert not spreads_through(jd.Blend(0.5, grey, glass)) and jd.Blend(0.5, grey, glass).transmissive
    assert spreads_through(jd.Principled(spec_trans=0.5)) and not spreads_through(jd.Principled())
    with pytest.raises(ValueError, match="TwoSided: Blend lets light through"):
        jd.TwoSided(jd.Blend(0.5, grey, glass))
    lamp = jd.Shape(jd.shapes.rectangle(), emitter=jd.AreaEmitter(1.0))
    scene = jd.Scene({"a": jd.Shape(jd.shapes.rectangle(), jd.Blend(0.5, grey, rough)), "lamp": lamp}, CAMERA)

    def image(t):
        moved = scene.replace({"a.vertices": scene.parameters()["a.vertices"] + t})
        return jd.render(moved, jax.random.key(0), 1, jd.PathTracer(max_depth=2))

    with pytest.raises(ValueError, match="seen through rough glass in a Blend have no derivative yet"):
        jax.eval_shape(lambda t: jax.jvp(image, (t,), (1.0,)), 0.0)
