"""Terms share one wavefront, and nothing else."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.boundary.film.film_edges import FilmEdges
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.geometry.shapes import box, rectangle
from jaxdr.integrators.base import prepare_terms, term_images
from jaxdr.moving import Moving
from jaxdr.scene.packed import pack
from jaxdr.transport.path import trace_paths
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples

KEY = jax.random.key(3)
SETTINGS = PathSettings(3, True, "auto")
SAMPLES = 8


def scene() -> jd.Scene:
    """A box over a floor, under a lamp and a dim sky."""
    shapes = {
        "box": jd.Shape(box((0.8, 0.8, 0.8), center=(0.0, 0.0, 0.6))),
        "floor": jd.Shape(rectangle(5.0, 5.0)),
        "lamp": jd.Shape(rectangle(1.0, 1.0, (0.8, 0.0, 3.0)), jd.TwoSided(jd.Diffuse(0.5)), jd.AreaEmitter(6.0)),
    }
    camera = jd.Perspective(jd.look_at([1, -5, 2.5], [0, 0, 0.4], [0, 0, 1]), 40.0, jd.Film(16, 12, jd.Box()))
    return jd.Scene(shapes, camera, environment=jd.ConstantEnvironment(0.2))


def derivative(terms):
    """Images of the derivatives of some terms by a translation of the box, by name."""
    of, moving = scene(), Moving((True, False, False), False)
    vertices = of.parameters()["box.vertices"]
    key_film, key_path, key_radiance, key_terms = jax.random.split(KEY, 4)

    @jax.jit
    def images(t):
        packed = pack(of.replace({"box.vertices": vertices + t * jnp.asarray([1.0, 0.3, 0.1])}))
        context = Context(packed, moving, SETTINGS, Form.FIXED, 1.0)
        prepared = prepare_terms(context, terms, key_terms)
        primary = primary_samples(packed, jnp.arange(SAMPLES), key_film, SETTINGS.rays, Form.FIXED)
        record = trace_paths(packed, primary.first, primary.direction, primary.u, key_path, SETTINGS)
        weight = jnp.full(SAMPLES, 1.0 / SAMPLES)
        chunk = Chunk(jnp.arange(SAMPLES), weight, primary, record, key_radiance)
        return term_images(context, terms, prepared, chunk, key_terms)

    values, derivatives = jax.jvp(images, (0.0,), (1.0,))
    assert not any(np.any(value) for value in jax.tree.leaves(values))
    return jax.device_get(derivatives)


def test_a_term_is_the_same_whatever_others_ask_for():
    kernel, edges = jd.KernelDensity(), FilmEdges()
    both, swapped = derivative([kernel, edges]), derivative([edges, kernel])
    for term in (kernel, edges):
        alone = derivative([term])[term.name]
        scale = np.abs(alone).max()
        assert scale > 0.01
        np.testing.assert_allclose(both[term.name], alone, rtol=1e-4, atol=1e-4 * scale)
        np.testing.assert_allclose(swapped[term.name], alone, rtol=1e-4, atol=1e-4 * scale)
