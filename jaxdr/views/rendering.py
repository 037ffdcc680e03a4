"""Renderings of a scene like photographs: the object, cut out as it is there, and its coverage."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.compilation import jit
from jaxdr.integrators import Integrator, PathTracer
from jaxdr.integrators.aov import AovImage
from jaxdr.render import render
from jaxdr.scene.camera import Perspective
from jaxdr.scene.film import Box, Film
from jaxdr.scene.scene import Scene
from jaxdr.views.record import View, scissors
from jaxdr.whole_numbers import check_spp


class Pinhole(NamedTuple):
    """The parameters of a camera that a compiled program takes: pose, field of view (degrees), principal point."""

    to_world: Float[Array | np.ndarray, "4 4"]
    fov: Float[Array | np.ndarray, ""]
    principal_point: Float[Array | np.ndarray, "2"]

    @classmethod
    def of(cls, view: View) -> "Pinhole":
        """The camera of a photograph."""
        return cls(*(jnp.asarray(x, float) for x in (view.to_world, view.fov, view.principal_point)))

    def camera(self, film: Film) -> Perspective:
        """The camera with this film."""
        return Perspective(self.to_world, self.fov, film, principal_point=self.principal_point)


class Layers(NamedTuple):
    """A picture in parts: `full` shows everything, `alpha` is the object's coverage, `behind` is the sky alone."""

    full: Float[Array, "H W 3"]
    alpha: Float[Array, "H W"]
    behind: Float[Array, "H W 3"]

    @property
    def over_black(self) -> Float[Array, "H W 3"]:
        """The object over black: the full picture minus the sky where the object does not cover it.

        It is exact, except in pixels that the object covers in part and within which the sky varies.
        """
        return self.full - (1.0 - self.alpha)[..., None] * self.behind


def layers(scene: Scene, camera: Perspective, key: PRNGKeyArray, spp: int, integrator: Integrator) -> Layers:
    """The parts of the picture of a scene, differentiable like `render`.

    Image and alpha share their film points. So what is behind cancels between them in every sample.
    """
    seen = Scene(scene.shapes, camera, scene.environment, scene.lights)
    full = render(seen, key, spp=spp, integrator=integrator)
    alpha = render(seen, key, spp=spp, integrator=AovImage("alpha", cast(Any, integrator).rays))[..., 0]
    if scene.environment is None:
        return Layers(full, alpha, jnp.zeros_like(full))
    x0, y0, width, height = camera.film.window
    rows, columns = jnp.meshgrid(jnp.arange(height) + y0 + 0.5, jnp.arange(width) + x0 + 0.5, indexing="ij")
    _, directions = camera.rays(jnp.stack([columns, rows], -1).astype(full.dtype).reshape(-1, 2))
    sky = jnp.broadcast_to(scene.environment.eval(directions), (height * width, 3))
    return Layers(full, alpha, sky.reshape(full.shape))


@checked
def render_views(
    scene: Scene, views: Sequence[View], *, spp: int = 64, seed: int = 0, integrator: Integrator | None = None
) -> list[Float[np.ndarray, "H W 4"]]:
    """Pictures [H, W, 4] of a scene from the cameras of photographs: linear RGB multiplied by alpha, and alpha.

    They are like the photographs (`View.backdrop`):

    - without alpha: everything is seen, and alpha is the coverage of the object.
    - cut out by their own alpha: what is behind the object is left out, also in the pixels that it covers in part.
    - with a mask: alpha is 1 where the object covers more than half of a pixel, else 0. These pixels show everything.

    `spp`: samples per pixel. `integrator`: default as in `render`. Views of the same size share a compiled program.
    Raises ValueError for spp < 1.
    """
    return list(each_rendered(scene, views, spp, seed, integrator))


def each_rendered(
    scene: Scene,
    views: Iterable[View],
    spp: int,
    seed: int,
    integrator: Integrator | None,
    caller: str = "render_views",
) -> Iterator[Float[np.ndarray, "H W 4"]]:
    """The pictures of `render_views` one by one, so that they need not all be in memory."""
    check_spp(caller, spp)
    integrator = integrator or PathTracer(boundary=None)
    key = jax.random.key(seed)
    for i, view in enumerate(views):
        program = _program(view.width, view.height, int(spp), integrator)
        parts = program(scene, Pinhole.of(view), jax.random.fold_in(key, i))
        yield _like(view, parts)


def _like(view: View, parts: Layers) -> Float[np.ndarray, "H W 4"]:
    """Colours and alpha on the host, cut out as the photograph is; see `render_views`."""
    alpha = np.clip(np.asarray(parts.alpha), 0.0, 1.0)
    if not view.masked:
        color = np.asarray(parts.full)
    elif view.backdrop:
        alpha = scissors(alpha)
        color = np.asarray(parts.full) * alpha[..., None]  # not `over_black`: a NaN of the renderer has to show
    else:
        color = np.where(alpha[..., None] > 0, np.maximum(np.asarray(parts.over_black), 0.0), 0.0)
    return np.concatenate([color, alpha[..., None]], -1)


@lru_cache(maxsize=8)
def _program(width: int, height: int, spp: int, integrator: Integrator) -> Callable:
    film = Film(width, height, Box())
    return jit(lambda scene, pinhole, key: layers(scene, pinhole.camera(film), key, spp, integrator))
