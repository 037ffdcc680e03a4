"""Functions of JAX as functions of PyTorch's tensors, with their derivatives: `import jaxdr.torch`.

Arrays are shared by DLPack, so nothing is copied. A tensor and its gradient stay on one device. PyTorch is optional.
"""

import types
from collections.abc import Callable, Mapping
from functools import cache, update_wrapper
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.dtypes import float0
from jaxtyping import PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.compilation import jit
from jaxdr.integrators import Integrator
from jaxdr.render import render as render_in_jax
from jaxdr.scene.scene import Scene

try:
    import torch
except ImportError as _missing:
    raise ImportError('jaxdr.torch needs PyTorch, which is optional: pip install -e ".[torch]"') from _missing


@checked
def from_jax(function: Callable) -> Callable:
    """A function of tensors that computes a function of JAX arrays. PyTorch differentiates it in both modes.

    Arguments and results are any nesting of dictionaries, lists and tuples. Tensors become arrays of the same shape,
    type and device, and arrays become tensors. Numbers and JAX arrays such as random keys are passed on, and have no
    derivative. All else, such as strings and flags, is static: the function is compiled for each value. It is compiled
    for each set of shapes and of tensors that need a gradient, so boundary terms are there only where they are needed.
    A function that is jitted already is taken without its `jit`.

    Raises ValueError for what can't be called, for a tensor that JAX can't share, for one of float64 or int64 that JAX
    would shorten, for a static argument that can't be hashed, inside `jax.jit`, and for a result that is no array.
    Second derivatives raise RuntimeError.
    """
    # JAX takes compiler options in the outermost function alone.
    return _FromJax(function.__wrapped__ if hasattr(function, "lower") else function)


@checked
def render(
    scene: Scene,
    parameters: Mapping[str, Any],
    key: PRNGKeyArray,
    spp: int = 64,
    integrator: Integrator | None = None,
) -> torch.Tensor:
    """Image [H, W, 3] of a scene with other values, as `jaxdr.render` makes it: a tensor with a derivative.

    `parameters` are tensors by the names of `scene.parameters()`, such as "ball.vertices"; numbers and JAX arrays are
    taken, too. The image is on the tensors' device. It is compiled once for each structure of the scene, names, `spp`
    and `integrator`.

    Raises ValueError as `Scene.replace`, `jaxdr.render` and `from_jax` do, and for an integrator with guides.
    """
    try:
        image = _renderer(spp, integrator)
    except TypeError as problem:
        raise ValueError(
            "jaxdr.torch.render: this integrator has arrays, such as guides, and can't be kept; make your own function "
            "once: from_jax(lambda parameters, key: jaxdr.render(scene.replace(parameters), key, spp, integrator))"
        ) from problem
    return image(scene, dict(parameters), key)


@cache
def _renderer(spp: int, integrator: Integrator | None) -> Callable:
    return from_jax(lambda scene, parameters, key: render_in_jax(scene.replace(parameters), key, spp, integrator))


class _Arguments(NamedTuple):
    """What is static about the arguments of a call; hashable."""

    structure: Any  # a jax.tree_util.PyTreeDef, of (arguments, arguments by name)
    static: tuple  # for each leaf: (value,), or None if it is traced
    wanted: tuple[bool, ...]  # for each traced leaf: whether it is differentiated

    def joined(self, differentiated: list, others: list) -> tuple[tuple, dict]:
        """The arguments, of the traced leaves in their order."""
        parts = {True: iter(differentiated), False: iter(others)}
        traced = (next(parts[wanted]) for wanted in self.wanted)
        leaves = [next(traced) if value is None else value[0] for value in self.static]
        return jax.tree.unflatten(self.structure, leaves)


class _FromJax:
    """What `from_jax` returns."""

    def __init__(self, function: Callable):
        self.function = function
        update_wrapper(self, function)
        self.value = jit(self._value, static_argnums=0)
        self.value_and_vjp = jit(self._value_and_vjp, static_argnums=0)
        self.tangent = jit(self._tangent, static_argnums=0)

    def __get__(self, owner: Any, kind: type | None = None) -> Callable:
        return self if owner is None else types.MethodType(self, owner)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        leaves, structure = jax.tree.flatten((arguments, named))
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            raise ValueError("jaxdr.torch: inside of jax.jit or jax.grad call the function of JAX arrays itself")
        static = tuple(None if _is_traced(leaf) else (leaf,) for leaf in leaves)
        traced = [leaf for leaf, value in zip(leaves, static, strict=True) if value is None]
        call = _Arguments(structure, static, tuple(map(_is_differentiated, traced)))
        try:
            hash(call)
        except TypeError as problem:
            raise ValueError(f"jaxdr.torch: an argument that is no number and no array: {problem}") from problem
        pairs = list(zip(traced, call.wanted, strict=True))
        others = [_array(leaf) for leaf, wanted in pairs if not wanted]
        results = _Function.apply(self, call, others, shape := [], *(leaf for leaf, wanted in pairs if wanted))
        return jax.tree.unflatten(shape[0], results)

    def _value(self, call: _Arguments, differentiated: list, others: list) -> Any:
        arguments, named = call.joined(differentiated, others)
        result = self.function(*arguments, **named)
        for leaf in jax.tree.leaves(result, is_leaf=lambda x: x is None):
            is_key = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
            if is_key or not isinstance(leaf, jax.Array | int | float | complex):
                kind = "a random key" if is_key else type(leaf).__name__
                raise ValueError(f"jaxdr.torch: the function returned {kind} where an array was expected")
        return jax.tree.map(jnp.asarray, result)

    def _value_and_vjp(self, call: _Arguments, differentiated: list, others: list) -> tuple:
        # The function that is returned is a pytree: what the derivative needs of the value is computed once.
        return jax.vjp(lambda x: self._value(call, x, others), differentiated)

    def _tangent(self, call: _Arguments, differentiated: list, others: list, tangents: list) -> Any:
        return jax.jvp(lambda x: self._value(call, x, others), (differentiated,), (tangents,))[1]


@jit
def _pulled_back(pullback: Callable, cotangent: Any) -> list:
    return pullback(cotangent)[0]


class _Function(torch.autograd.Function):
    """A call of `_FromJax`, as PyTorch's autograd sees it. Its cotangents are the conjugates of JAX's."""

    @staticmethod
    def forward(ctx, owner: _FromJax, call: _Arguments, others: list, shapes: list, *tensors: torch.Tensor):
        ctx.owner, ctx.call, ctx.others, ctx.pullback = owner, call, others, None
        ctx.set_materialize_grads(False)
        # PyTorch refuses a derivative if a tensor was changed in place since: JAX reads the same memory again.
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)
        arrays = [_array(tensor) for tensor in tensors]
        if any(ctx.needs_input_grad):
            result, ctx.pullback = owner.value_and_vjp(call, arrays, others)
        else:
            result = owner.value(call, arrays, others)
        leaves, structure = jax.tree.flatten(result)
        shapes.append(structure)
        ctx.structure, ctx.leaves = structure, [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
        results = [_tensor(leaf) for leaf in leaves]
        ctx.mark_non_differentiable(*(result for result in results if not _is_smooth(result)))
        return tuple(results)

    @staticmethod
    def backward(ctx, *cotangents):
        tensors = ctx.saved_tensors
        leaves = [_cotangent(leaf, cotangent) for leaf, cotangent in zip(ctx.leaves, cotangents, strict=True)]
        gradients = _pulled_back(ctx.pullback, jax.tree.unflatten(ctx.structure, leaves))
        found = [_tensor(jnp.conj(g)).to(t.dtype) for g, t in zip(gradients, tensors, strict=True)]
        return None, None, None, None, *_first_only(found, tensors, cotangents)

    @staticmethod
    def jvp(ctx, _owner, _call, _others, _shapes, *tangents):
        tensors = ctx.saved_tensors
        arrays = [_array(tensor) for tensor in tensors]
        pairs = zip(arrays, tangents, strict=True)
        moves = [jnp.zeros_like(x) if t is None else _array(t).astype(x.dtype) for x, t in pairs]
        leaves = jax.tree.leaves(ctx.owner.tangent(ctx.call, arrays, ctx.others, moves))
        found = iter(_first_only([_tensor(leaf) for leaf in leaves if leaf.dtype != float0], tensors, tangents))
        return tuple(None if leaf.dtype == float0 else next(found) for leaf in leaves)


def _first_only(derivatives: list, tensors: tuple, directions: tuple) -> tuple:
    """Derivatives that depend on tensors and directions in a way that is not known: they can't be differentiated."""
    return _FirstOnly.apply(len(derivatives), *derivatives, *tensors, *directions)


class _FirstOnly(torch.autograd.Function):
    @staticmethod
    def forward(ctx, count: int, *given):
        return tuple(derivative.view_as(derivative) for derivative in given[:count])

    @staticmethod
    def backward(ctx, *_):
        raise RuntimeError("jaxdr.torch: functions of JAX have first derivatives only")

    @staticmethod
    def jvp(ctx, *_):
        raise RuntimeError("jaxdr.torch: functions of JAX have first derivatives only")


def _is_traced(leaf: Any) -> bool:
    if isinstance(leaf, bool):
        return False
    return isinstance(leaf, torch.Tensor | jax.Array | int | float | complex) or hasattr(leaf, "__array__")


def _is_differentiated(leaf: Any) -> bool:
    if not isinstance(leaf, torch.Tensor) or not _is_smooth(leaf):
        return False
    has_tangent = torch.autograd.forward_ad.unpack_dual(leaf).tangent is not None
    return has_tangent or (leaf.requires_grad and torch.is_grad_enabled())


def _is_smooth(tensor: torch.Tensor) -> bool:
    return tensor.is_floating_point() or tensor.is_complex()


def _array(leaf: Any) -> jax.Array:
    """The array that shares its memory with a tensor. Raises ValueError for a tensor that JAX can't share."""
    if not isinstance(leaf, torch.Tensor):
        return jnp.asarray(leaf)
    if leaf.dtype in (torch.float64, torch.complex128) and not jax.config.jax_enable_x64:
        raise ValueError(
            "jaxdr.torch: a tensor is float64, and JAX computes in float32: take tensor.float(), or call "
            'jax.config.update("jax_enable_x64", True) first'
        )
    if leaf.dtype == torch.int64 and not jax.config.jax_enable_x64 and leaf.numel():
        if max(int(leaf.max()), -int(leaf.min())) >= 2**31:
            raise ValueError("jaxdr.torch: a tensor is int64, with numbers that don't fit into JAX's int32")
    try:
        # JAX shares what is in order and copies the rest. Bits of lazy negation and conjugation are resolved.
        return jax.dlpack.from_dlpack(leaf.detach().resolve_conj().resolve_neg().contiguous())
    except (RuntimeError, BufferError, TypeError, ValueError) as problem:
        kind = f"{leaf.layout}, {leaf.dtype}, {leaf.device}"
        raise ValueError(f"jaxdr.torch: a tensor ({kind}) can't be shared with JAX: {problem}") from problem


def _tensor(array: jax.Array) -> torch.Tensor:
    """The tensor that shares its memory with an array: a result of a jitted function, which nobody else has."""
    return torch.from_dlpack(jax.block_until_ready(array))


def _cotangent(leaf: jax.ShapeDtypeStruct, cotangent: torch.Tensor | None) -> Any:
    if not jnp.issubdtype(leaf.dtype, jnp.inexact):
        return jnp.zeros(leaf.shape, float0)
    return jnp.zeros(leaf.shape, leaf.dtype) if cotangent is None else _array(cotangent.conj())
