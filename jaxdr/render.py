"""Rendering: the image and its derivative.

`render` has its own derivative rule. The image comes from one key. Its tangent is a second estimate with an independent
key, the sum of interior and boundary terms. So an image without derivatives pays for no boundary term, and the gradient
of a non-linear loss of the image is unbiased.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr import loops
from jaxdr.argument_kinds import checked
from jaxdr.boundary.shared.refusals import refuse
from jaxdr.boundary.shared.texture_jumps import MOVED_MAPS
from jaxdr.callers_line import warn
from jaxdr.chunked_sum import chunked_derivative, dependent, first_only
from jaxdr.compilation import unfolded
from jaxdr.integrators import Integrator, PathTracer
from jaxdr.integrators.base import Batch
from jaxdr.integrators.choice import settled
from jaxdr.integrators.known_failures import warn_of_known_failure, warn_of_turning_away
from jaxdr.kernels import computed
from jaxdr.moving import Moving, moving_in
from jaxdr.scene.packed import PackedScene, pack
from jaxdr.scene.scene import Scene
from jaxdr.transport.keys import inner_key
from jaxdr.whole_numbers import check_spp


class Program(NamedTuple):
    """Everything static about a rendering; hashable. `integrator` has no arrays."""

    structure: Any  # a jax.tree_util.PyTreeDef
    is_float: tuple[bool, ...]
    spp: int
    integrator: Integrator
    compute: str  # see `PathTracer`


@checked
def render(
    scene: Scene, key: PRNGKeyArray, spp: int = 64, integrator: Integrator | None = None
) -> Float[Array, "H W 3"]:
    """Image [H, W, 3] of a scene: linear RGB, row 0 at the top. Differentiable in every float parameter of the scene.

    - `key`: a JAX random key. The same key and arguments give the same image, bit for bit on CPU. Image and derivative
      use independent keys that are split from it.
    - `spp`: samples per pixel.
    - `integrator`: the default is `PathTracer()`. Its boundary estimator is chosen for the scene, by structure alone
      ([rules](choosing.md)). `jaxdr.plan` measures which estimator suits.

    Works under jit, grad, vjp, jvp, and vmap over keys. Which parameters are differentiated is known when the program
    is traced, and only the terms that they need are compiled.

    Raises ValueError for spp < 1 or an argument of the wrong kind. Warns with `EstimatorWarning` if the derivative's
    estimator fails by nature on the scene.
    """
    _check("render", scene, spp, integrator)
    program, floats, others, arrays = _program(scene, spp, PathTracer() if integrator is None else integrator)
    return _render(program, floats, others, arrays, inner_key(key))


@checked
def derivative_terms(
    scene: Scene, key: PRNGKeyArray, spp: int = 64, integrator: Integrator | None = None, moving: Moving | None = None
) -> dict[str, Float[Array, "H W 3"]]:
    """The terms of `render`, by name. Its derivative is the sum of theirs: differentiate a term to see its part.

    - `interior`: the image in value. All others are zero in value.
    - `silhouettes`, `creases`: edges that move in the image.
    - `boundary`: visibility changes behind the first hit.
    - `pixel_borders`: with a box filter and indirect light.
    - `shadows`: with lights without area.
    - `chains`: with mirrors and smooth glass.
    - `warp`: with `primary="warp"`, in place of `silhouettes` and `creases`.

    Everything counts as moving unless `moving` says otherwise. Raises ValueError and warns as `render` does, and raises
    ValueError for a `moving` of another scene, and for derivatives by what moves against its word.
    """
    _check("derivative_terms", scene, spp, integrator)
    moving = _everything(scene) if moving is None else moving
    _check_moving(scene, moving)
    taken = settled(PathTracer() if integrator is None else integrator, scene)
    program, floats, others, _ = _program(scene, spp, taken)
    floats = _watched((program, moving), floats, others)
    return _estimate(_join(program, floats, unfolded(others)), inner_key(key), spp, taken, moving)


def _check(caller: str, scene: Scene, spp: int, integrator: Integrator | None) -> None:
    """Raises ValueError for no samples, and for scenes that the integrator does not take.

    Warns of a scene without light.
    """
    check_spp(caller, spp)
    if not scene.lights and scene.environment is None and all(s.emitter is None for s in scene.shapes.values()):
        remedy = "give a shape an emitter, or the scene an environment or lights"
        warn(f"jaxdr: {caller}: the scene has no light, so its image is black; {remedy}")
    (PathTracer() if integrator is None else integrator).check(scene)


def _everything(scene: Scene) -> Moving:
    return moving_in(scene, jax.tree.map(eqx.is_inexact_array, scene))


def _check_derivative(integrator: Integrator, flags: Scene, moving: Moving) -> None:
    """Raises ValueError for derivatives that no integrator with boundary terms has; warns where a part is missing.

    `flags`: what is differentiated. What moves is refused by `Integrator.prepare`.
    """
    if integrator.boundary is not None:
        refuse((MOVED_MAPS,), flags)
        warn_of_turning_away(flags, moving, integrator.max_depth)


def _check_moving(scene: Scene, moving: Moving) -> None:
    for what, flags, members in (("shapes", moving.shapes, scene.shapes), ("lights", moving.lights, scene.lights)):
        # `lights` may be left out.
        if len(flags) != len(members) and (flags or what == "shapes"):
            raise ValueError(
                f"derivative_terms: moving has {len(flags)} flags of {what}, and the scene has {len(members)} {what}; "
                "give one flag for each"
            )


def _check_still(scene: Scene, found: Moving, moving: Moving) -> None:
    """Raises ValueError if something is `found` to move, and `moving` says that it stays."""
    lights = moving.lights or (False,) * len(scene.lights)
    moves = dict(zip(scene.shapes, zip(found.shapes, moving.shapes, strict=True), strict=True))
    moves |= dict(zip(scene.lights, zip(found.lights, lights, strict=True), strict=True))
    moves |= {"camera": (found.camera, moving.camera), "environment": (found.environment, moving.environment)}
    for name, (does, said) in moves.items():
        if does and not said:
            raise ValueError(
                f"derivative_terms: {name} moves, and moving says that it stays; set its flag in jaxdr.Moving, or "
                "leave moving out"
            )


def _program(scene: Scene, spp: int, integrator: Integrator):
    """(static part of a rendering, float leaves of the scene, its other leaves, arrays of the integrator)."""
    leaves, structure = jax.tree.flatten(scene)
    is_float = tuple(jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in leaves)
    floats, others = _split(leaves, is_float)
    arrays, static = eqx.partition(integrator, eqx.is_array)
    compute = getattr(integrator, "compute", "auto")  # foreign integrators may have no choice
    return Program(structure, is_float, int(spp), static, compute), floats, others, arrays


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _watched(static: tuple[Program, Moving], floats, others):
    """`floats`, `unfolded`. Raises ValueError when somebody takes a derivative by them that is not covered."""
    return unfolded(floats)


@partial(_watched.defjvp, symbolic_zeros=True)
def _watched_jvp(static, primals, tangents):
    (program, moving), (floats, others) = static, primals
    active = tuple(not isinstance(t, SymbolicZero) for t in tangents[0])
    flags = _flags(program, active)
    scene = _join(program, floats, others)
    found = moving_in(scene, flags)
    _check_derivative(program.integrator, flags, found)
    if program.integrator.boundary is not None:
        _check_still(scene, found, moving)
    floats = jax.tree.map(first_only, floats)
    return unfolded(floats), tangents[0]  # the barrier's own rule would make zeros of what is not differentiated


def _flags(program: Program, active: tuple[bool, ...]) -> Scene:
    """A scene whose leaves say whether they are differentiated."""
    return _join(program, active, (False,) * (len(program.is_float) - sum(program.is_float)))


def _split(leaves, is_float):
    floats = tuple(leaf for leaf, f in zip(leaves, is_float, strict=True) if f)
    return floats, tuple(leaf for leaf, f in zip(leaves, is_float, strict=True) if not f)


def _join(program: Program, floats, others) -> Scene:
    floats, others = iter(floats), iter(others)
    return jax.tree.unflatten(program.structure, [next(floats) if f else next(others) for f in program.is_float])


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _render(program: Program, floats, others, arrays, key):
    return _image(program, floats, others, arrays, jax.random.split(key)[0])


@partial(_render.defjvp, symbolic_zeros=True)
def _render_jvp(program, primals, tangents):
    floats, others, arrays, key = primals
    derivative_key = jax.random.split(key)[1]
    image = _render(program, floats, others, arrays, key)
    active = tuple(not isinstance(t, SymbolicZero) for t in tangents[0])
    if not any(active):
        return image, jnp.zeros_like(image)
    moved = tuple(t for t in tangents[0] if not isinstance(t, SymbolicZero))
    return image, _derivative(program, active, moved, floats, others, arrays, derivative_key)


def _derivative(program: Program, active: tuple[bool, ...], moved, floats, others, arrays, key):
    """Derivative of the sum of interior and boundary terms along `moved`, of the `active` floats."""
    floats = tuple(map(first_only, floats))
    flags = _flags(program, active)
    scene = _join(program, floats, others)
    moving = moving_in(scene, flags)
    integrator = settled(eqx.combine(program.integrator, arrays), scene)
    arrays, static = eqx.partition(integrator, eqx.is_array)
    program = program._replace(integrator=static)
    _check_derivative(integrator, flags, moving)
    still, others, arrays = unfolded((floats, *jax.lax.stop_gradient((others, arrays))))

    def packed_at(at):
        """The packed scene as a function of the active floats."""
        at = iter(at)
        return pack(_join(program, [next(at) if a else f for f, a in zip(still, active, strict=True)], others))

    at = tuple(f for f, a in zip(floats, active, strict=True) if a)
    moves = dependent(lambda at: jax.tree.leaves(packed_at(at)), at)

    def moving_leaves(at):
        packed = packed_at(at)
        return [leaf for leaf, m in zip(jax.tree.leaves(packed), moves, strict=True) if m], packed

    primal, tangent, packed = jax.jvp(moving_leaves, (at,), (moved,), has_aux=True)
    leaves, structure = jax.tree.flatten(packed)
    prepared, key = _prepare(_join(program, floats, others), packed, integrator, moving, key)
    fixed = [leaf for leaf, m in zip(leaves, moves, strict=True) if not m], prepared, arrays, key
    term = _Chunk(program, moving, structure, moves)
    _, _, width, height = packed.camera.film.window
    out = jax.ShapeDtypeStruct((height, width, 3), packed.vertices.dtype)
    chunks, _ = _chunks(packed, integrator, program.spp, True)
    return chunked_derivative(term, chunks, primal, tangent, fixed, out, program.compute)


class _Chunk(NamedTuple):
    """The image of one chunk of samples, interior and boundary terms, as `chunked_derivative` takes it."""

    program: Program
    moving: Moving
    structure: Any  # of the packed scene
    moves: tuple[bool, ...]

    def __call__(self, at, fixed, index):
        rest, prepared, arrays, key = fixed
        at, rest = iter(at), iter(rest)
        packed = jax.tree.unflatten(self.structure, [next(at) if m else next(rest) for m in self.moves])
        integrator, spp = eqx.combine(self.program.integrator, arrays), self.program.spp
        batch = _batch(packed, integrator, spp, True, key, index)
        images = integrator.estimate(packed, prepared, batch, self.moving)
        first, *others = images.values()
        return sum(others, start=first)


@partial(jax.jit, static_argnums=0)
def _image(program: Program, floats, others, arrays, key):
    def image(floats, others, arrays, key):
        integrator = eqx.combine(program.integrator, arrays)
        return _estimate(_join(program, floats, others), key, program.spp, integrator, None)["interior"]

    floats, others, arrays = unfolded((floats, others, arrays))
    return computed(image, program.compute)(floats, others, arrays, key)


def _prepare(scene: Scene, packed: PackedScene, integrator: Integrator, moving: Moving, key, apart: bool = False):
    """(states of the terms for all chunks, or None; key of the chunks)."""
    if not moving.any:
        return None, key
    rest, pilot_key = jax.random.split(key)
    prepared = integrator.prepare(scene, packed, moving, pilot_key, apart)
    if _has_boundary_term(integrator, moving):
        warn_of_known_failure(scene, integrator.boundary)
    return prepared, key if prepared is None else rest


def _has_boundary_term(integrator: Integrator, moving: Moving) -> bool:
    return integrator.max_depth > 1 and (any(moving.seen) or moving.environment)


def _chunks(packed: PackedScene, integrator: Integrator, spp: int, differentiated: bool) -> tuple[int, int]:
    """(number of chunks, samples of every pixel in each)."""
    _, _, width, height = packed.camera.film.window
    chunks = min(spp, -(-spp * width * height // integrator.paths_at_once(differentiated)))
    return chunks, -(-spp // chunks)


def _batch(packed: PackedScene, integrator: Integrator, spp: int, differentiated: bool, key, index) -> Batch:
    """The samples of one chunk."""
    _, count = _chunks(packed, integrator, spp, differentiated)
    samples = index * count + jnp.arange(count)
    key_film, key_chunks = jax.random.split(key)
    return Batch(samples, spp, key_film, jax.random.fold_in(key_chunks, index))


def _estimate(scene: Scene, key, spp: int, integrator: Integrator, moving: Moving | None) -> dict:
    """Sum over chunks of samples, by term. Chunks are rematerialised, so memory does not grow with samples per pixel.

    Without `moving` there is only the interior term, in value.
    """
    packed, prepared = pack(scene), None
    if moving is not None:
        prepared, key = _prepare(scene, packed, integrator, moving, key, apart=True)
    chunks, _ = _chunks(packed, integrator, spp, moving is not None)

    def chunk(packed, index):
        batch = _batch(packed, integrator, spp, moving is not None, key, index)
        return integrator.estimate(packed, prepared, batch, moving, apart=True)

    if chunks == 1:
        return chunk(packed, 0)
    body = jax.checkpoint(chunk)

    def accumulate(total, index):
        return jax.tree.map(jnp.add, total, body(packed, index)), None

    _, _, width, height = packed.camera.film.window
    black = jnp.zeros((height, width, 3), packed.vertices.dtype)
    return loops.scan(accumulate, dict.fromkeys(["interior", *(prepared or ())], black), jnp.arange(chunks))[0]
