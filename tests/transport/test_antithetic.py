"""Antithetic BSDF samples: the same derivative with less noise in a narrow lobe."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

SPP = 2  # many samples are as even as a lattice, and nearly opposite without this


def scene():
    """A rough mirror under a smooth sky, that fills the view."""
    rows = np.linspace(0.0, np.pi, 9)[:, None, None]
    columns = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)[:, None]
    sky = 1.0 + 0.5 * np.sin(rows) * np.sin(columns + np.array([0.0, 1.0, 2.0]))
    mirror = jd.Mesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    eye = jd.look_at((0.0, -3.0, 2.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    shapes = {"mirror": jd.Shape(mirror, jd.RoughConductor(0.05))}
    return jd.Scene(shapes, jd.Perspective(eye, 20.0, jd.Film(4, 4, jd.Box())), jd.EnvironmentMap(sky))


def derivatives(antithetic, keys=24):
    """Of the image by a tilt of the mirror, interior term alone, [keys, H, W, 3]."""
    of = scene()
    rest = of.parameters()["mirror.vertices"]
    tilt = jnp.stack([0 * rest[:, 0], 0 * rest[:, 0], rest[:, 1]], -1)
    integrator = jd.PathTracer(2, boundary=None, antithetic=antithetic)

    @jax.jit
    def one(key):
        def image(angle):
            return jd.render(of.replace({"mirror.vertices": rest + angle * tilt}), key, SPP, integrator)

        return jax.jvp(image, (0.0,), (1.0,))[1]

    return np.stack([one(key) for key in jax.random.split(jax.random.key(0), keys)])


def test_same_mean_with_less_noise():
    plain, paired = derivatives(False), derivatives(True)
    error = np.sqrt((plain.var(0, ddof=1) + paired.var(0, ddof=1)) / len(plain))
    z = (plain.mean(0) - paired.mean(0)) / error
    assert np.abs(z).max() < 4.5
    assert paired.std(0).mean() < 0.6 * plain.std(0).mean()


def test_pairs_of_film_offsets_are_taken():
    with pytest.raises(ValueError, match="antithetic"):
        jd.PathTracer(antithetic=True, primary="material")
