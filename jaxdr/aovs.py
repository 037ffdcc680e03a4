"""Arbitrary output variables (AOVs): properties of what camera rays hit, as images."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Int, PRNGKeyArray

from jaxdr import loops
from jaxdr.argument_kinds import checked
from jaxdr.compilation import unfolded
from jaxdr.geometry.queries import check_rays
from jaxdr.integrators.aov import CONTINUOUS, FLOATS, AovImage, aov_values
from jaxdr.render import render
from jaxdr.scene.packed import PackedScene, pack
from jaxdr.scene.scene import Scene
from jaxdr.transport.interaction import intersect
from jaxdr.transport.keys import inner_key
from jaxdr.transport.primary import Form, primary_samples
from jaxdr.whole_numbers import check_spp

CHUNK = 1 << 18  # camera rays at once

# Numbers at pixel centres. To add one, add a function and a line.
IDS: dict[str, Callable[[PackedScene, Int[Array, " N"]], Int[Array, " N"]]] = {
    "face": lambda packed, face: face - jnp.asarray(packed.first_face)[packed.face_shape[face]],
    "shape": lambda packed, face: packed.face_shape[face],
}
NAMES = (*FLOATS, *IDS)


class _Settings(NamedTuple):
    names: tuple[str, ...]
    spp: int
    rays: str


@checked
def render_aovs(
    scene: Scene, key: PRNGKeyArray, spp: int = 64, names: str | Iterable[str] = NAMES, rays: str = "auto"
) -> dict[str, Array]:
    """Properties of what camera rays hit, by name: a dictionary of floats [H, W, C] and int32 numbers [H, W].

    Floats are means over `spp` samples per pixel, weighted by the pixel filter, as in Mitsuba's `aov` integrator. A
    sample that hits nothing counts as zero. At borders both sides are mixed.

    - `alpha` (C = 1): coverage, the share of samples that hit a surface of any kind.
    - `depth` (C = 1): distance along the ray, in scene units, from the pinhole, from the point on the lens, or from the
      plane of a parallel camera. (Mitsuba measures from the near plane.)
    - `position` (C = 3): world space.
    - `shading_normal` (C = 3): world space, unit length, on the side to which the surface's normal points.
    - `albedo` (C = 3): share of light from all directions that is scattered towards the camera. It is estimated by one
      BSDF sample each, and exact for diffuse surfaces. Black surfaces, and backs of one-sided surfaces, have zero.

    int32 numbers are those at pixel centres, seen from the centre of the lens; -1 means that nothing is hit. `shape` is
    an index into `scene.shapes`, `face` an index into the faces of that shape's mesh.

    `alpha`, `depth` and `position` are differentiable by everything that moves surfaces or the camera: silhouettes have
    the term that they have in `render`. Value and derivative use independent random numbers. Ask for these names alone.
    The others jump elsewhere, too.

    `rays` names the implementation of the ray queries, as in `PathTracer`. Raises ValueError for unknown names, for
    spp < 1, and when another float is differentiated. Then take `jax.lax.stop_gradient` of the scene.
    """
    names = (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        if name not in NAMES:
            raise ValueError(f"render_aovs: names has an unknown name {name!r}; known: {', '.join(NAMES)}")
    check_spp("render_aovs", spp)
    check_rays("render_aovs", rays)
    found = _images(_Settings(names, int(spp), rays), scene, inner_key(key))
    return {name: found[name] for name in names}


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _images(settings: _Settings, scene: Scene, key) -> dict[str, Array]:
    return _render(settings, scene, key)


@partial(_images.defjvp, symbolic_zeros=True)
def _images_jvp(settings: _Settings, primals, tangents):
    scene, key = primals
    images = _images(settings, scene, key)
    leaves, structure = jax.tree.flatten(scene)
    moved = jax.tree.leaves(tangents[0], is_leaf=_is_zero)
    active = [not _is_zero(t) for t in moved]
    if not any(active):
        return images, {name: _zero(image) for name, image in images.items()}
    for name in settings.names:
        if name in FLOATS and name not in CONTINUOUS:
            raise ValueError(
                f"render_aovs: {name} has no derivative, because it jumps inside outlines; differentiate "
                f"{', '.join(CONTINUOUS)} alone, or take stop_gradient of the scene"
            )

    def image(at, name):
        at = iter(at)
        moving = jax.tree.unflatten(structure, [next(at) if a else x for a, x in zip(active, leaves, strict=True)])
        return render(moving, key, settings.spp, AovImage(name, settings.rays))[..., : images[name].shape[-1]]

    at, along = ([x for a, x in zip(active, table, strict=True) if a] for table in (leaves, moved))

    def tangent(name):
        if name in IDS:
            return _zero(images[name])
        return jax.jvp(partial(image, name=name), (at,), (along,))[1]

    return images, {name: tangent(name) for name in images}


def _is_zero(tangent) -> bool:
    return isinstance(tangent, SymbolicZero)


def _zero(image):
    """A tangent of zero; whole numbers have tangents without a type of their own."""
    if jnp.issubdtype(image.dtype, jnp.floating):
        return jnp.zeros_like(image)
    return np.zeros(image.shape, jax.dtypes.float0)


@partial(jax.jit, static_argnums=0)
def _render(settings: _Settings, scene: Scene, key) -> dict[str, Array]:
    packed = pack(unfolded(scene))
    images = {}
    if any(name in FLOATS for name in settings.names):
        images |= _averages(settings, packed, key)
    ids = [name for name in settings.names if name in IDS]
    if ids:
        face, shape = _central_faces(settings, packed)
        images |= {n: jnp.where(face >= 0, IDS[n](packed, jnp.maximum(face, 0)), -1).reshape(shape) for n in ids}
    return images


def _averages(settings: _Settings, packed: PackedScene, key) -> dict[str, Array]:
    _, _, width, height = packed.camera.film.window
    names = [name for name in settings.names if name in FLOATS]
    per_chunk = max(1, min(settings.spp, CHUNK // (width * height)))

    def chunk(total, index):
        samples = index * per_chunk + jnp.arange(per_chunk)
        primary = primary_samples(packed, samples, key, settings.rays, Form.FIXED)
        counts = jnp.tile(samples < settings.spp, width * height)
        values = {n: jnp.where(counts[:, None], aov_values(n, packed, primary), 0.0) / settings.spp for n in names}
        return {n: total[n] + v.reshape(height, width, per_chunk, -1).sum(2) for n, v in values.items()}, None

    first = jax.eval_shape(lambda: primary_samples(packed, jnp.arange(1), key, settings.rays, Form.FIXED))
    shapes = {name: jax.eval_shape(FLOATS[name], packed, first) for name in names}
    start = {name: jnp.zeros((height, width, s.shape[1]), s.dtype) for name, s in shapes.items()}
    return loops.scan(chunk, start, jnp.arange(-(-settings.spp // per_chunk)))[0]


def _central_faces(settings: _Settings, packed: PackedScene):
    """(faces that the rays through pixel centres hit, the shape of the image)."""
    x0, y0, width, height = packed.camera.film.window
    row, column = jnp.divmod(jnp.arange(width * height), width)
    centre = jnp.stack([column + x0, row + y0], -1).astype(packed.vertices.dtype) + 0.5
    view = packed.camera.view()
    origin, direction = view.rays(centre)
    start, reach = view.clipped(origin, direction)
    hit = intersect(packed, start, direction, jnp.ones(width * height, bool), settings.rays, reach)
    return hit.face, (height, width)
