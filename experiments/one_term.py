"""One term of the derivative alone, without paths and without other terms. What it prepares is made once."""

import jax
import jax.numpy as jnp

from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.integrators.base import term_images
from jaxdr.moving import Moving
from jaxdr.scene.packed import pack
from jaxdr.transport.path import PathRecord
from jaxdr.transport.primary import Form, primary_samples


def context(scene, moving, settings):
    """What the term shares with others, where the shapes flagged in `moving` move."""
    return Context(pack(scene), Moving(tuple(moving), False), settings, Form.FIXED, 1.0)


def image(term, context, state, samples, key):
    """Image [H, W, 3] of a term that takes nothing from paths; as of `samples` paths from every pixel."""
    key_film, key_radiance, key_terms = jax.random.split(key, 3)
    numbers = jnp.arange(samples)
    primary = primary_samples(context.packed, numbers, key_film, context.settings.rays, context.form)
    nothing = PathRecord(jnp.zeros_like(primary.direction), None, None)
    weight = jnp.full(samples, 1.0 / samples, primary.direction.dtype)
    chunk = Chunk(numbers, weight, primary, nothing, key_radiance)
    return term_images(context, [term], {term.name: state}, chunk, key_terms)[term.name]
