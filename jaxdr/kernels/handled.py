"""Operations that have a handler in C++ of their own, which is no kernel."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.kernels import machine
from jaxdr.kernels.flatten import Equation

KEY = "key<pcg4>"  # of keys inside renderings, `jaxdr.transport.keys`


class Handler(NamedTuple):
    """The file with the handler, the kinds of numbers it takes, and the parameters it is told, as whole numbers."""

    file: str
    kinds: tuple[str, ...]
    told: tuple[str, ...] = ()


# XLA makes many small loops of each of these, which take long to compile.
HANDLERS: Mapping[str, Handler] = {
    "rows_where": Handler("rows_where.h", ("bool",), ("fill",)),
    "cumsum": Handler("cumsum.h", ("float32", "int32", "uint32"), ("axis", "reverse")),
    "random_split": Handler("keys.h", (KEY,)),
    "random_fold_in": Handler("keys.h", (KEY,)),
}


def has_handler(equation: Equation) -> bool:
    """Whether a handler takes an operation on these operands. Keys are derived one by one."""
    handler = HANDLERS.get(equation.name)
    if handler is None or equation.inputs[0].kind not in handler.kinds:
        return False
    return equation.inputs[0].kind != KEY or all(not v.shape for v in equation.inputs)


def target_of(equation: Equation) -> str:
    """The name of XLA's call of the handler; see `machine.target`."""
    text = machine.declarations() + machine.library_text(HANDLERS[equation.name].file)
    return machine.target(text, kernel=False)


def handled(target: str, equation: Equation, operands: Sequence[Any]) -> Any:
    """The result of an operation with a handler."""
    (out,) = equation.outputs
    told = {name: np.int64(equation.parameters[name]) for name in HANDLERS[equation.name].told}
    if out.kind != KEY:
        return jax.ffi.ffi_call(target, jax.ShapeDtypeStruct(out.shape, out.aval.dtype))(*operands, **told)
    key, *others = operands
    words = jax.random.key_data(key)
    call = jax.ffi.ffi_call(target, jax.ShapeDtypeStruct((*out.shape, *words.shape), jnp.uint32))
    return jax.random.wrap_key_data(call(words, *others, **told), impl=jax.random.key_impl(key))
