"""Properties of what camera rays hit, and an integrator of them: so their images have derivatives as `render` has.

With camera rays fixed, such an image is an integral over the film. Its integrand changes where surfaces slide under the
rays, and jumps at silhouettes. Where it is continuous on surfaces, silhouettes are its only boundary term.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.boundary.film.film_edges import FilmEdges
from jaxdr.boundary.shared.term import Chunk, Context, pixel_sums
from jaxdr.geometry.vector import norm
from jaxdr.integrators.base import Batch, prepare_terms, term_images
from jaxdr.moving import Moving
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene
from jaxdr.sizes import at_once
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, PrimarySamples, primary_samples
from jaxdr.transport.radiance import Answers
from jaxdr.transport.shading import Scatterer

EDGE_SAMPLES = 0.125  # points on silhouettes per camera ray; each takes two rays


def _alpha(packed: PackedScene, primary: PrimarySamples) -> Float[Array, "N 1"]:
    return jnp.ones((primary.direction.shape[0], 1), primary.direction.dtype)


def _depth(packed: PackedScene, primary: PrimarySamples) -> Float[Array, "N 1"]:
    view, first = primary.view, primary.first
    ahead = jnp.asarray([0.0, 0.0, 1.0], first.position.dtype)
    hit = first.valid[:, None]
    origin, _ = view.rays(view.project_local(jnp.where(hit, view.local(first.position), ahead)))
    return norm(jnp.where(hit, first.position - origin, ahead))[:, None]


def _albedo(packed: PackedScene, primary: PrimarySamples) -> Float[Array, "N 3"]:
    scatterer = Scatterer(packed, primary.first, -primary.direction)
    sampled = scatterer.sample(primary.u[:, 2:])
    density = scatterer.pdf(sampled)[:, None]
    return jnp.where(density > 0, scatterer.eval(sampled) / jnp.where(density > 0, density, 1.0), 0.0)


# Values where camera rays hit something. To add one, add a function and a line.
FLOATS: dict[str, Callable[[PackedScene, PrimarySamples], Float[Array, "N C"]]] = {
    "alpha": _alpha,
    "depth": _depth,
    "position": lambda packed, primary: primary.first.position + packed.centre,
    "shading_normal": lambda packed, primary: primary.first.shading_normal,
    "albedo": _albedo,
}
CONTINUOUS = ("alpha", "depth", "position")  # on surfaces: they jump at silhouettes alone


def aov_values(name: str, packed: PackedScene, primary: PrimarySamples) -> Float[Array, "N C"]:
    """One of `FLOATS` for every camera ray, zero where it hits nothing."""
    return jnp.where(primary.first.valid[:, None], FLOATS[name](packed, primary), 0.0)


class AovImage(eqx.Module):
    """An integrator of one of `CONTINUOUS`. Its image has three channels: those of the values, or thrice the same.

    `rays` names the implementation of the ray queries.
    """

    name: str = eqx.field(static=True)
    rays: str = eqx.field(static=True, default="auto")
    max_depth: int = eqx.field(static=True, default=1)
    boundary: None = eqx.field(static=True, default=None)  # no light, so no boundary behind the first hit

    def __check_init__(self):
        assert self.name in CONTINUOUS

    def check(self, scene: Scene) -> None:
        """Every scene has such images."""

    def paths_at_once(self, differentiated: bool) -> int:
        """Number of camera rays in a chunk."""
        return at_once(cpu=1 << 16, gpu=1 << 20)

    def prepare(
        self, scene: Scene, packed: PackedScene, moving: Moving, key: PRNGKeyArray, apart: bool = False
    ) -> dict[str, Any]:
        """The distribution over the silhouettes of what moves relative to the camera."""
        return prepare_terms(self._context(packed, moving), [_Silhouettes(self.name)], key)

    def _context(self, packed: PackedScene, moving: Moving) -> Context:
        return Context(packed, moving, PathSettings(1, False, self.rays), Form.FIXED, EDGE_SAMPLES)

    def estimate(
        self, packed: PackedScene, prepared: Any, batch: Batch, moving: Moving | None, apart: bool = False
    ) -> dict[str, Float[Array, "H W 3"]]:
        """The part of the image from a batch of camera rays, by term."""
        primary = primary_samples(packed, batch.samples, batch.key_film, self.rays, Form.FIXED)
        weight = batch.weights(primary.direction.dtype)
        images = {"interior": pixel_sums(packed, _three(aov_values(self.name, packed, primary)), weight)}
        if moving is None or prepared is None:
            return images
        chunk = Chunk(batch.samples, weight, primary, None, batch.key)
        return images | term_images(
            self._context(packed, moving), [_Silhouettes(self.name)], prepared, chunk, batch.key
        )


class _Silhouettes:
    """`FilmEdges` of silhouettes, with an AOV on both sides in place of radiance."""

    name = "silhouettes"

    def __init__(self, aov: str):
        self.aov, self.edges = aov, FilmEdges("silhouettes")

    def prepare(self, context: Context, key):
        return self.edges.prepare(context, key)

    def draw(self, context: Context, state, chunk: Chunk, key):
        """Points on silhouettes and the values on both sides; no light is asked for."""
        _, held = self.edges.draw(context, state, chunk, key)
        points = held.points
        first, direction = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), (points.first, points.direction))
        lens = None if points.lens is None else jnp.tile(points.lens, (2, 1))
        one = jnp.ones(direction.shape[0], direction.dtype)
        primary = PrimarySamples(context.packed.camera.view(lens), first, direction, one[:, None], one, None)
        values = _three(aov_values(self.aov, context.packed, primary))
        return None, (held, Answers(values, jnp.zeros_like(values)))

    def image(self, context: Context, state, chunk: Chunk, held, answers: Answers | None) -> Float[Array, "H W 3"]:
        """Jumps x normal velocities."""
        del answers
        return self.edges.image(context, state, chunk, *held)


def _three(values: Float[Array, "N C"]) -> Float[Array, "N 3"]:
    return jnp.broadcast_to(values, (values.shape[0], 3))
