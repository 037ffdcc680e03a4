"""Light from textured surfaces: densities of samples, the flux they find, and derivatives by texels that are black."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, transformed
from jaxdr.scene.packed import pack
from jaxdr.transport.emission import emitted, emitting_surface_pdf, sample_emitting_surface, surface_radiance

CAMERA = jd.Perspective(jd.look_at((0, -3, 3), (0, 0, 0), (0, 0, 1)), 30.0, jd.Film(8, 8, jd.Box()))
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
FLOOR = jd.Shape(rectangle(4.0, 4.0), jd.Diffuse(0.7))
COUNT = 1 << 16


def panel(texture, x=0.0):
    """A square of one unit, two above the floor."""
    return jd.Shape(transformed(rectangle(1.0, 1.0, (x, 0.0, -2.0)), DOWN), jd.Diffuse(0.0), jd.AreaEmitter(texture))


def test_samples_find_the_flux():
    """Mean of radiance / density = integral over the surface, of a texture that is black on most of it."""
    pixels = np.zeros((8, 8, 3))
    pixels[6, 1], pixels[2, 5] = (9.0, 6.0, 3.0), (1.0, 2.0, 4.0)
    packed = pack(jd.Scene({"floor": FLOOR, "lamp": panel(jd.Bitmap(pixels)), "other": panel(0.3, 1.5)}, CAMERA))
    u = jax.random.uniform(jax.random.key(0), (COUNT, 2))
    point, density = sample_emitting_surface(packed, u)
    np.testing.assert_allclose(density, emitting_surface_pdf(packed, point), rtol=1e-5)
    for values, exact in ((surface_radiance(packed, point), pixels.mean((0, 1)) + 0.3), (jnp.ones((COUNT, 1)), 2.0)):
        found = np.asarray(values / density[:, None], float)
        error = found.std(0) / COUNT**0.5
        assert np.all(error < 0.05 * exact) and np.all(np.abs(found.mean(0) - exact) < 4 * error), (
            found.mean(0),
            exact,
        )
    # From behind there is none.
    above, below = (emitted(packed, point, jnp.broadcast_to(jnp.asarray([0.0, 0.0, z]), (COUNT, 3))) for z in (1, -1))
    np.testing.assert_array_equal(above, 0)
    np.testing.assert_array_equal(below, surface_radiance(packed, point))


def test_black_texels_have_derivatives():
    """The image is linear in the texels, also while another light outshines them all."""
    of = jd.Scene({"floor": FLOOR, "lamp": panel(jd.Bitmap(np.zeros((2, 2, 3)))), "other": panel(5.0, 1.5)}, CAMERA)
    name, integrator = "lamp.emitter.radiance.pixels", jd.PathTracer(max_depth=2)

    @jax.jit
    def both(key):
        def total(pixels):
            return jd.render(of.replace({name: pixels}), key, 64, integrator).mean()

        slope = jax.grad(total)(jnp.zeros((2, 2, 3)))
        return slope.sum(), total(jnp.ones((2, 2, 3))) - total(jnp.zeros((2, 2, 3)))

    rows = np.array([jax.device_get(both(key)) for key in jax.random.split(jax.random.key(1), 8)])
    (slope, difference), errors = rows.mean(0), rows.std(0, ddof=1) / 8**0.5
    assert np.all(errors < 0.05 * difference), (slope, difference, errors)
    assert abs(slope - difference) < 4 * np.hypot(*errors), (slope, difference, errors)
