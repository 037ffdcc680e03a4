"""Operations that have a handler in C++ of their own, which is no kernel."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxdr.kernels import machine
from jaxdr.kernels.flatten import Equation


class Handler(NamedTuple):
    """The file with the handler, the kinds of numbers it takes, and the parameters it is told, as whole numbers."""

    file: str
    kinds: tuple[str, ...]
    told: tuple[str, ...]


# XLA makes each running sum a tree of some ten small loops, which take long to compile.
HANDLERS: Mapping[str, Handler] = {
    "rows_where": Handler("rows_where.h", ("bool",), ("fill",)),
    "cumsum": Handler("cumsum.h", ("float32", "int32", "uint32"), ("axis", "reverse")),
}


def has_handler(equation: Equation) -> bool:
    """Whether a handler takes an operation on these kinds of numbers."""
    handler = HANDLERS.get(equation.name)
    return handler is not None and equation.inputs[0].kind in handler.kinds


def target_of(equation: Equation) -> str:
    """The name of XLA's call of the handler; see `machine.target`."""
    text = machine.declarations() + machine.library_text(HANDLERS[equation.name].file)
    return machine.target(text, kernel=False)


def handled(target: str, equation: Equation, operand: Any) -> Any:
    """The result of an operation with a handler."""
    (out,) = equation.outputs
    call = jax.ffi.ffi_call(target, jax.ShapeDtypeStruct(out.shape, out.aval.dtype))
    return call(operand, **{name: np.int64(equation.parameters[name]) for name in HANDLERS[equation.name].told})
