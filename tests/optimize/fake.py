"""A stand-in for the renderer: smooth, cheap, noisy like the real one, and a function of vertices, camera and key."""

import jax
import jax.numpy as jnp


def render(scene, key, spp, integrator):
    """Gaussian blobs at the projected vertices of the object, with noise that falls with the samples per pixel."""
    camera = scene.camera
    size = camera.film.height, camera.film.width
    points = camera.project(scene.shapes["object"].mesh.vertices)
    rows, columns = (jnp.arange(n) + 0.5 for n in size)
    across = jnp.exp(-0.5 * ((columns[:, None] - points[:, 0]) / 1.5) ** 2)
    down = jnp.exp(-0.5 * ((rows[:, None] - points[:, 1]) / 1.5) ** 2)
    image = 4.0 * down @ across.T / len(points)
    noise = 1 + 0.05 * jax.random.normal(key, (*size, 3)) / spp**0.5
    return image[..., None] * noise
