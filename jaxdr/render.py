"""Rendering, top to bottom: draw paths -> contributions -> interior + boundary -> film.

`render` has its own derivative rule: the image comes from one key, its tangent from a second estimate with an
independent key, the sum of interior and boundary terms. An image that nobody differentiates pays for no boundary term,
and the gradient of a non-linear loss of the image is unbiased.
"""

import dataclasses
import warnings
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.boundary.edge_reservoir import EdgeTable
from jaxdr.boundary.film_chains import chain_edges, film_chain_term
from jaxdr.boundary.film_edges import EdgeDistribution, edge_distribution, film_edge_terms
from jaxdr.boundary.hard_shadows import (
    ShadowDistribution,
    film_shadow_term,
    scattered_shadow_term,
    shadow_distribution,
)
from jaxdr.boundary.pixel_borders import pixel_border_term
from jaxdr.boundary.silhouettes import PathSegments
from jaxdr.boundary.texture_jumps import check_still_jumps, check_still_maps
from jaxdr.boundary.warped_camera import warped_camera_term
from jaxdr.integrator import BidirectionalPathTracer, PathTracer
from jaxdr.scene.bsdf import BSDF, NormalMap
from jaxdr.scene.bsdf.base import only_delta, spreads_through
from jaxdr.scene.camera import Perspective
from jaxdr.scene.camera.pinhole import PinholeCamera
from jaxdr.scene.packed import PackedScene, pack
from jaxdr.scene.scene import Scene, unwrap
from jaxdr.transport.bidirectional import bidirectional_paths
from jaxdr.transport.emission import has_emitters
from jaxdr.transport.path import PathSettings, trace_paths
from jaxdr.transport.primary import primary_samples
from jaxdr.transport.radiance import arriving_radiance

Integrator = PathTracer | BidirectionalPathTracer

# Parameters of lights without area that move their shadows.
PLACES = ("position", "direction", "to_world", "fov")


class Moving(NamedTuple):
    """What is being differentiated that moves: shapes, camera, lights without area, the environment. Static.

    A shape counts as well where its smooth glass bends light otherwise.
    """

    shapes: tuple[bool, ...]
    camera: bool
    lights: tuple[bool, ...] = ()
    environment: bool = False

    @property
    def seen(self) -> tuple[bool, ...]:
        """Which shapes move relative to the camera."""
        return (True,) * len(self.shapes) if self.camera else self.shapes

    @property
    def any(self) -> bool:
        """Whether visibility can change at all."""
        return any(self.seen) or any(self.lights) or self.environment


class Prepared(NamedTuple):
    """What all chunks share: distributions over edges and shadows, edges seen in mirrors, the estimator's own.

    None where there are no such terms. `warps`: warped areas in place of the edges.
    """

    edges: EdgeDistribution | None = None
    boundary: Any = None
    shadows: ShadowDistribution | None = None
    chains: EdgeTable | None = None
    warps: bool = False


class Plan(NamedTuple):
    """Everything static about a rendering; hashable."""

    structure: Any  # a jax.tree_util.PyTreeDef
    is_float: tuple[bool, ...]
    spp: int
    integrator: Integrator


def render(
    scene: Scene, key: PRNGKeyArray, spp: int = 64, integrator: Integrator | None = None
) -> Float[Array, "H W 3"]:
    """Image [H, W, 3] of a scene, linear RGB, row 0 at the top; differentiable in every float parameter of the scene.

    `spp` samples per pixel. Works under jit, grad, vjp, jvp and vmap over keys; the same key and arguments give the
    same image bit for bit on CPU. Image and derivative use independent keys split from `key`. Which parameters are
    differentiated is known when the program is traced, and only the terms they need are compiled.
    Raises ValueError for spp < 1 or an argument of the wrong kind.
    """
    integrator = PathTracer() if integrator is None else integrator
    if not isinstance(scene, Scene):
        raise ValueError(f"render: expected a jaxdr.Scene, got {type(scene).__name__}")
    if not isinstance(integrator, Integrator):
        raise ValueError(f"render: expected an integrator such as jaxdr.PathTracer(), got {type(integrator).__name__}")
    if int(spp) != spp or spp < 1:
        raise ValueError(f"render: spp must be a positive whole number of samples per pixel, got {spp}")
    pixel_filter = scene.camera.film.filter
    if isinstance(integrator, PathTracer) and integrator.primary != "fixed_ray" and not pixel_filter.smooth:
        raise ValueError(
            f'render: primary="{integrator.primary}" differentiates the pixel filter, and a '
            f"{type(pixel_filter).__name__} has no derivative of finite variance; use Gaussian"
        )
    leaves, structure = jax.tree.flatten(scene)
    is_float = tuple(jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in leaves)
    floats, others = _split(leaves, is_float)
    return _render(Plan(structure, is_float, int(spp), integrator), floats, others, key)


def derivative_terms(
    scene: Scene, key: PRNGKeyArray, spp: int = 64, integrator: Integrator | None = None, moving: Moving | None = None
) -> dict[str, Float[Array, "H W 3"]]:
    """The image that `render`'s derivative is taken of, by term: differentiate it to see each term on its own.

    Keys: `interior` (the image in value), `silhouettes`, `creases`, `boundary` (zero in value); with a box filter and
    indirect light `pixel_borders`, with lights without area `shadows`, with mirrors and smooth glass `chains`, with
    `primary="warp"` `warp` in place of `silhouettes` and `creases`.
    Everything counts as moving unless `moving` says otherwise.
    """
    integrator = PathTracer() if integrator is None else integrator
    turns = hasattr(scene.environment, "to_world")
    moving = moving or Moving((True,) * len(scene.shapes), True, (True,) * len(scene.lights), turns)
    return _estimate(scene, key, spp, integrator, moving)


def _split(leaves, is_float):
    floats = tuple(leaf for leaf, f in zip(leaves, is_float, strict=True) if f)
    return floats, tuple(leaf for leaf, f in zip(leaves, is_float, strict=True) if not f)


def _join(plan: Plan, floats, others) -> Scene:
    floats, others = iter(floats), iter(others)
    return jax.tree.unflatten(plan.structure, [next(floats) if f else next(others) for f in plan.is_float])


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _render(plan: Plan, floats, others, key):
    return _image(plan, floats, others, jax.random.split(key)[0])


@partial(_render.defjvp, symbolic_zeros=True)
def _render_jvp(plan, primals, tangents):
    floats, others, key = primals
    image_key, derivative_key = jax.random.split(key)
    image = _image(plan, floats, others, image_key)
    active = tuple(not isinstance(t, SymbolicZero) for t in tangents[0])
    if not any(active):
        return image, jnp.zeros_like(image)
    moved = tuple(t for t in tangents[0] if not isinstance(t, SymbolicZero))
    at = tuple(f for f, a in zip(floats, active, strict=True) if a)

    def estimate(at):
        return _derivative_image(plan, active, at, floats, others, derivative_key)

    return image, jax.jvp(estimate, (at,), (moved,))[1]


@partial(jax.jit, static_argnums=0)
def _image(plan: Plan, floats, others, key):
    terms = _estimate(_join(plan, floats, others), key, plan.spp, plan.integrator, None)
    return terms["interior"]


@partial(jax.jit, static_argnums=(0, 1))
def _derivative_image(plan: Plan, active, at, floats, others, key):
    at = iter(at)
    floats = [next(at) if a else jax.lax.stop_gradient(f) for f, a in zip(floats, active, strict=True)]
    flags = _join(plan, active, (False,) * (len(plan.is_float) - sum(plan.is_float)))
    if plan.integrator.boundary is not None:
        check_still_maps(flags)
    moving = _moving(flags)
    terms = _estimate(_join(plan, floats, others), key, plan.spp, plan.integrator, moving)
    return sum(terms.values())


def _moving(active: Scene) -> Moving:
    """Which geometry moves, from a scene whose leaves say whether they are differentiated."""
    return Moving(
        shapes=tuple(bool(shape.mesh.vertices) or _bends(unwrap(shape.bsdf)) for shape in active.shapes.values()),
        camera=any(jax.tree.leaves(active.camera)),
        lights=tuple(any(getattr(light, name, False) for name in PLACES) for light in active.lights.values()),
        environment=bool(getattr(active.environment, "to_world", False)),
    )


def _bends(active: BSDF) -> bool:
    """Whether directions of delta lobes change with the BSDF's own parameters, from one whose leaves say which do."""
    if not active.delta:
        return False
    own = active.normal if isinstance(active, NormalMap) else getattr(active, "eta", None)
    inner = getattr(active, "bsdf", None)
    own = (active.transmissive or isinstance(active, NormalMap)) and any(jax.tree.leaves(own))
    return own or (inner is not None and _bends(inner))


def _estimate(scene: Scene, key, spp: int, integrator: Integrator, moving: Moving | None) -> dict:
    """Sum over chunks of samples. Chunks are rematerialised: memory does not grow with the samples per pixel.

    Without `moving` the terms are those of an image that nobody differentiates: the interior's value alone.
    """
    packed = pack(scene)
    _, _, width, height = scene.camera.film.window
    pixels = width * height
    chunks = -(-spp * pixels // integrator.paths_at_once(differentiated=moving is not None))
    chunks = min(chunks, spp)
    per_chunk = -(-spp // chunks)
    prepared, material = None, False
    if isinstance(integrator, BidirectionalPathTracer):
        if moving is not None and moving.any:
            _check_motion(packed, moving)
            material = any(moving.seen)
            if integrator.boundary is not None:
                _check_connected(scene, packed, moving)
                key, pilot_key = jax.random.split(key)
                prepared = _prepare_connected(packed, moving, pilot_key, integrator) if material else None
    elif moving is not None and moving.any and integrator.boundary is not None:
        _check_rough_glass(scene)
        _check_transmission(packed, integrator)
        check_still_jumps(scene, moving.seen, integrator.primary == "fixed_ray", integrator.settings.attached)
        packed = dataclasses.replace(packed, environment_turns=moving.environment)
        key, pilot_key = jax.random.split(key)
        prepared = _prepare(packed, moving, pilot_key, integrator)
    key_film, key_chunks = jax.random.split(key)

    def chunk(packed, index):
        samples = index * per_chunk + jnp.arange(per_chunk)
        key_chunk = jax.random.fold_in(key_chunks, index)
        if isinstance(integrator, BidirectionalPathTracer):
            return _bidirectional_chunk(packed, prepared, samples, key_film, key_chunk, spp, integrator, material)
        if moving is None:
            return _image_chunk(packed, samples, key_film, key_chunk, spp, integrator)
        return _chunk(packed, prepared, samples, key_film, key_chunk, spp, integrator)

    if chunks == 1:
        return chunk(packed, 0)
    body = jax.checkpoint(chunk)

    def accumulate(total, index):
        return jax.tree.map(jnp.add, total, body(packed, index)), None

    start = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(chunk, packed, 0))
    return jax.lax.scan(accumulate, start, jnp.arange(chunks))[0]


def _check_motion(packed: PackedScene, moving: Moving) -> None:
    """Raises ValueError for what a `BidirectionalPathTracer` does not move."""
    name, remedy = "BidirectionalPathTracer", "take PathTracer(boundary=None) for the interior term of what moves"
    if packed.has_delta_lobes and (any(moving.seen) or any(moving.lights)):
        raise ValueError(
            f"render: paths of a {name} over delta lobes do not move with mirrors and smooth glass; {remedy}"
        )
    pixel_filter = packed.camera.film.filter
    if any(moving.seen) and not pixel_filter.smooth:
        raise ValueError(
            f"render: a {name} differentiates the pixel filter where surfaces move, and a "
            f"{type(pixel_filter).__name__} has no derivative of finite variance; use Gaussian, or {remedy}"
        )


def _check_connected(scene: Scene, packed: PackedScene, moving: Moving) -> None:
    """Raises ValueError for what a `BidirectionalPathTracer` has no boundary terms of."""
    _check_rough_glass(scene)
    if packed.light_count and (any(moving.seen) or any(moving.lights)):
        raise ValueError(
            "render: shadows of lights without area have no derivative with a BidirectionalPathTracer; take lights "
            "with an area, PathTracer, or boundary=None for the interior term alone"
        )


def _check_transmission(packed: PackedScene, integrator: PathTracer) -> None:
    """Raises ValueError where boundary terms are missing; warns of what is left out with mirrors and smooth glass."""
    if not packed.has_delta_lobes:
        return
    if integrator.primary != "fixed_ray":
        raise ValueError(
            f'render: visibility changes seen over delta lobes have no derivative with primary="{integrator.primary}"; '
            'use primary="fixed_ray", or boundary=None for the interior term alone'
        )
    if packed.light_count and integrator.max_depth > 2:
        raise ValueError(
            "render: hard shadows seen over delta lobes have no derivative yet; take lights with an area, max_depth=2, "
            "or boundary=None for the interior term alone"
        )
    if integrator.max_depth > 2 and not all(only_delta(group.bsdf) for group in packed.bsdfs):
        warnings.warn(
            "jaxdr: the derivative lacks visibility changes of reflected/refracted light from diffuse surfaces via "
            "delta surfaces (a path that leaves a surface that spreads light, meets a mirror or smooth glass and goes "
            "on); what the camera sees over delta surfaces is there",
            stacklevel=2,
        )


def _check_rough_glass(scene: Scene) -> None:
    """Raises ValueError where the boundary terms of light that spreads through a surface are missing or not tested."""
    for name, shape in scene.shapes.items():
        bsdf = unwrap(shape.bsdf)
        if not spreads_through(bsdf):
            continue
        what = remedy = None
        if isinstance(getattr(bsdf, "bsdf", None), BSDF):
            what, remedy = f"in a {type(bsdf).__name__}", "rough glass alone"
        elif shape.mesh.normal_faces is not None:
            what, remedy = "with interpolated normals", "flat faces"
        elif scene.lights:
            what, remedy = "beside lights without area", "lights with an area"
        if what is not None:
            raise ValueError(
                f"render: visibility changes seen through rough glass {what} have no derivative yet ({name}); take "
                f"{remedy}, differentiate nothing that moves, or boundary=None for the interior term alone"
            )


def _check_warp(packed: PackedScene) -> None:
    """Raises ValueError for what a `warped_camera_term` does not know."""
    if not isinstance(packed.camera, PinholeCamera):
        raise ValueError(
            f'render: primary="warp" needs a camera with a position, not {type(packed.camera).__name__}; take a '
            'Perspective or a ThinLens, or primary="fixed_ray"'
        )
    if packed.light_count:
        raise ValueError(
            'render: silhouettes of what lights without area light up have no derivative with primary="warp"; take '
            'lights with an area, or primary="fixed_ray"'
        )


def _prepare(packed: PackedScene, moving: Moving, key, integrator: PathTracer) -> Prepared:
    """Only what can move: where nothing but lights does, there are no terms but for their shadows."""
    edges = boundary = shadows = chains = None
    warps = integrator.primary == "warp" and any(moving.seen)
    if any(moving.seen):
        if packed.has_delta_lobes and integrator.max_depth > 1:
            chains = chain_edges(packed, moving.seen, integrator.rays)
        if warps:
            _check_warp(packed)
        else:
            edges = edge_distribution(packed, moving.seen, key)
    if any(moving.seen) or moving.environment:
        boundary = integrator.boundary.prepare(packed, moving.seen, integrator.settings)
    if packed.light_count and integrator.max_depth > 1:
        if not isinstance(packed.camera, Perspective):
            raise ValueError(
                f"render: hard shadows seen by a {type(packed.camera).__name__} camera have no derivative yet; take a "
                "Perspective, or boundary=None for the interior term alone"
            )
        if integrator.max_depth > 2 and integrator.settings.attached > 0:
            raise ValueError(
                "render: hard shadows seen in attached lobes have no derivative yet; set attached=0, max_depth=2, or "
                "boundary=None for the interior term alone"
            )
        lights = moving.lights or (False,) * packed.light_count
        shadows = shadow_distribution(packed, moving.seen, lights, integrator.settings)
    return Prepared(edges, boundary, shadows, chains, warps)


def _prepare_connected(packed: PackedScene, moving: Moving, key, integrator: BidirectionalPathTracer) -> Prepared:
    """The same for pairs of subpaths."""
    settings = PathSettings(integrator.max_depth, True, integrator.rays)
    boundary = integrator.boundary.prepare(packed, moving.seen, settings)
    return Prepared(edge_distribution(packed, moving.seen, key), boundary)


def _bidirectional_chunk(
    packed: PackedScene, prepared: Prepared | None, samples, key, chunk_key, spp, integrator, moving: bool
) -> dict:
    """The same as `_chunk` for pairs of subpaths."""
    film, rays = packed.camera.film, integrator.rays
    primary, found = bidirectional_paths(packed, samples, key, chunk_key, integrator.settings, moving)
    share = _weights(samples, spp, found.value.dtype)
    terms = {"interior": found.image(film, found.value * found.weight[..., None], share, moving)}
    if prepared is None or prepared.edges is None:
        return terms
    _, _, width, height = film.window
    key_boundary, key_edges = jax.random.split(jax.random.fold_in(chunk_key, 1))
    points = max(1, round(primary.u.shape[0] * integrator.edge_points_per_sample))
    settings = PathSettings(integrator.max_depth, True, rays)
    edges = film_edge_terms(packed, prepared.edges, points, key_edges, settings, "material")
    terms["silhouettes"] = share.sum() * edges.silhouettes
    if found.drawn is not None and has_emitters(packed):
        index = jnp.tile(samples, width * height)
        weight = jnp.where((found.value != 0).any(-1), found.weight, 0.0)
        options = weight, index, key_boundary, rays
        values = integrator.boundary.estimate_connected(packed, prepared.boundary, primary, found.drawn, *options)
        terms["boundary"] = found.image(film, values, share, False)
    return terms


def _image_chunk(packed: PackedScene, samples, key, chunk_key, spp, integrator) -> dict:
    """The same as `_chunk` in value, for images that nobody differentiates."""
    settings = integrator.settings
    primary = primary_samples(packed, samples, key, settings.rays, "fixed", integrator.antithetic)
    radiance = arriving_radiance(packed, primary.first, primary.direction, primary.u, chunk_key, settings)
    return {"interior": _pixel_sums(packed, radiance, _weights(samples, spp, radiance.dtype))}


def _weights(samples, spp: int, dtype) -> Float[Array, " n"]:
    """What samples by their numbers count in their pixels."""
    return jnp.where(samples < spp, 1.0 / spp, 0.0).astype(dtype)


def _pixel_sums(packed: PackedScene, values: Float[Array, "N 3"], weight: Float[Array, " n"]) -> Float[Array, "H W 3"]:
    """Image of values of all samples, those of a pixel in a row."""
    _, _, width, height = packed.camera.film.window
    return (values.reshape(width * height, -1, 3) * weight[:, None]).sum(1).reshape(height, width, 3)


def _chunk(packed: PackedScene, prepared: Prepared | None, samples, key, chunk_key, spp, integrator) -> dict:
    """Share of the image from the samples numbered `samples` of every pixel; those from `spp` on count zero."""
    _, _, width, height = packed.camera.film.window
    pixels, count = width * height, samples.shape[0]
    key_path, key_boundary, key_edges = jax.random.split(chunk_key, 3)
    moves = prepared is not None and (prepared.edges is not None or prepared.warps)
    settings, form = integrator.settings, _form(packed, integrator, moves)
    if prepared is None:
        settings = settings._replace(attached=0.0)  # where nothing moves all forms are one
    primary = primary_samples(packed, samples, key, settings.rays, form, integrator.antithetic)
    record = trace_paths(packed, primary.first, primary.direction, primary.u, key_path, settings, primary.near)
    radiance = record.radiance * primary.weight[:, None]
    weight = _weights(samples, spp, radiance.dtype)

    def gather(values):
        return _pixel_sums(packed, values, weight)

    terms = {"interior": gather(radiance)}
    if prepared is None:
        return terms
    points = max(1, round(pixels * count * integrator.edge_points_per_sample))
    if prepared.edges is not None:
        edges = film_edge_terms(packed, prepared.edges, points, key_edges, settings, form)
        share = weight.sum()
        terms |= {"silhouettes": share * edges.silhouettes, "creases": share * edges.creases}
        if form == "near" and packed.camera.film.filter.tiles:
            sides = max(1, round(count * integrator.edge_points_per_sample / 4))
            key_borders = jax.random.fold_in(key_edges, 2)
            terms["pixel_borders"] = share * pixel_border_term(packed, sides, key_borders, settings)
    if prepared.warps:
        key_camera = jax.random.fold_in(key_edges, 4)
        options = prepared.boundary, integrator.boundary, primary, record, key_camera, settings
        terms["warp"] = gather(warped_camera_term(packed, *options))
    film_term = getattr(integrator.boundary, "film_term", None)
    if prepared.boundary is not None and film_term is not None:
        image = film_term(packed, prepared.boundary, pixels * count, key_boundary, settings, form)
        terms["boundary"] = weight.sum() * image
    elif prepared.boundary is not None:
        index = jnp.tile(samples, pixels)
        total = integrator.boundary.estimate(packed, prepared.boundary, primary, record, index, key_boundary, settings)
        terms["boundary"] = gather(total)
    if prepared.chains is not None:
        key_chains = jax.random.fold_in(key_edges, 3)
        terms["chains"] = weight.sum() * film_chain_term(packed, prepared.chains, pixels * count, key_chains, settings)
    if prepared.shadows is not None:
        key_film, key_scattered = jax.random.split(jax.random.fold_in(key_edges, 1))
        shadows = weight.sum() * film_shadow_term(packed, prepared.shadows, points, key_film, settings, form)
        if settings.max_depth > 2 and record.direct is not None:
            paths = PathSegments(packed, primary, record.direct)
            shadows += gather(scattered_shadow_term(packed, prepared.shadows, paths, key_scattered, settings))
        terms["shadows"] = shadows
    return terms


def _form(packed: PackedScene, integrator: PathTracer, moves: bool) -> str:
    """How first hits move, see `primary_samples`; without boundary terms of moving edges as they always did."""
    if not moves:
        return "fixed"
    if integrator.primary != "fixed_ray":
        return "material"
    # Of direct light only what emitters that touch a surface send comes from close by: not worth a second form.
    pixel_filter = packed.camera.film.filter
    return "near" if (pixel_filter.smooth or pixel_filter.tiles) and integrator.max_depth > 2 else "fixed"
