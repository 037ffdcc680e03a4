"""A jaxpr as one list of equations: calls and short loops are written out, and what nobody uses is left out."""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend import core

# Calls that are only a grouping. Derivative and batching rules have done their work where a program is fused.
CALLS = {
    "pjit": "jaxpr",
    "jit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "remat": "jaxpr",
    "remat2": "jaxpr",
    "checkpoint": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vmap_call": "call",
}
SMALL = 64  # numbers: at most so many components in a row, and so many in an array that kernels read as a whole
TURNS, BODY = 32, 80  # a loop of so many turns and equations is written out


class Value:
    """What an equation reads or makes. An array or key that is known has its `constant`."""

    def __init__(self, aval: Any, constant: Any = None):
        self.aval = aval
        self.constant = constant

    # Asked some ten times of each value: a large part of the time to plan a program.
    @cached_property
    def shape(self) -> tuple[int, ...]:
        return self.aval.shape

    @cached_property
    def size(self) -> int:
        return math.prod(self.shape)

    @cached_property
    def kind(self) -> str:
        return str(self.aval.dtype)


class Equation:
    """One operation of JAX: a primitive with its parameters."""

    __slots__ = ("acts", "inputs", "outputs", "parameters", "primitive")

    def __init__(self, primitive: Any, inputs: list[Value], outputs: list[Value], parameters: dict, acts: bool = False):
        self.primitive, self.inputs, self.outputs, self.parameters = primitive, inputs, outputs, parameters
        self.acts = acts  # whether it does more than to compute its outputs

    @property
    def name(self) -> str:
        return self.primitive.name


def flat(closed: core.ClosedJaxpr, known: Sequence[Any] = ()) -> tuple[list, list[Equation], list[Value]]:
    """(inputs, equations, outputs) of a jaxpr without constants; `known` has the arrays of inputs that are known."""
    known = known or [None] * len(closed.jaxpr.invars)
    inputs = [Value(v.aval, k) for v, k in zip(closed.jaxpr.invars, known, strict=True)]
    writer = _Writer()
    outputs = writer.inline(closed.jaxpr, closed.consts, inputs)
    return inputs, _used(writer.equations, outputs), outputs


class _Writer:
    """Writes equations out, each computation once."""

    def __init__(self):
        self.equations: list[Equation] = []
        self.found: dict[Any, list[Value]] = {}
        self.literals: dict[Any, Value] = {}

    def constant(self, array: Any, aval: Any) -> Value:
        if jnp.issubdtype(aval.dtype, jax.dtypes.extended):  # a key
            return Value(aval, array)
        array = np.asarray(array, aval.dtype)
        key = array.shape, array.dtype.str, array.tobytes()
        if key not in self.literals:
            self.literals[key] = Value(jax.ShapeDtypeStruct(array.shape, array.dtype), array)
        return self.literals[key]

    def inline(self, jaxpr: core.Jaxpr, constants: Sequence[Any], arguments: Sequence[Value]) -> list[Value]:
        values: dict[Any, Value] = dict(zip(jaxpr.invars, arguments, strict=True))
        values |= {v: self.constant(c, v.aval) for v, c in zip(jaxpr.constvars, constants, strict=True)}

        def read(atom) -> Value:
            return self.constant(atom.val, atom.aval) if isinstance(atom, core.Literal) else values[atom]

        for equation in jaxpr.eqns:
            inputs = [read(atom) for atom in equation.invars]
            outputs = self.written(equation, inputs)
            values |= dict(zip(equation.outvars, outputs, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def written(self, equation: core.JaxprEqn, inputs: list[Value]) -> list[Value]:
        name, parameters = equation.primitive.name, equation.params
        if name in CALLS:
            inner = parameters[CALLS[name]]
            if isinstance(inner, core.ClosedJaxpr):
                return self.inline(inner.jaxpr, inner.consts, inputs)
            return self.inline(inner, [], inputs)
        if name in ("stop_gradient", "copy", "name", "optimization_barrier", "pvary"):
            return inputs
        if name == "cond" and parameters.get("branches_platforms"):
            branch = parameters["branches"][_of_cpu(parameters["branches_platforms"])]
            return self.inline(branch.jaxpr, branch.consts, inputs[1:])
        if name == "scan" and _is_short(parameters, inputs):
            return self.unrolled(parameters, inputs)
        avals = [v.aval for v in equation.outvars]
        return self.equation(equation.primitive, inputs, avals, parameters, bool(equation.effects))

    def equation(self, primitive: Any, inputs: list[Value], avals: list[Any], parameters: dict, acts: bool):
        key: Any = None
        if not acts and not any(map(_has_program, parameters.values())):
            key = primitive, tuple(map(id, inputs)), tuple((k, str(v)) for k, v in sorted(parameters.items()))
            if key in self.found:
                return self.found[key]
        outputs = [Value(aval) for aval in avals]
        self.equations.append(Equation(primitive, inputs, outputs, parameters, acts))
        if key is not None:
            self.found[key] = outputs
        return outputs

    def unrolled(self, parameters: dict, inputs: list[Value]) -> list[Value]:
        count, carried = parameters["num_consts"], parameters["num_carry"]
        constants, carry, xs = inputs[:count], inputs[count : count + carried], inputs[count + carried :]
        turns = range(parameters["length"])
        for turn in reversed(turns) if parameters["reverse"] else turns:
            entries = [self.constant(x.constant[turn], jax.ShapeDtypeStruct(x.shape[1:], x.aval.dtype)) for x in xs]
            carry = self.inline(parameters["jaxpr"].jaxpr, parameters["jaxpr"].consts, [*constants, *carry, *entries])
        return carry


_PROGRAMS = core.Jaxpr, core.ClosedJaxpr, np.ndarray, jax.Array


def _has_program(parameter: Any) -> bool:
    """Whether the text of a parameter leaves out something: constants of a jaxpr, numbers of an array."""
    return isinstance(parameter, _PROGRAMS) or (isinstance(parameter, tuple) and any(map(_has_program, parameter)))


def _of_cpu(platforms: Sequence[Sequence[str] | None]) -> int:
    """The branch for CPUs of a choice by platform: the one that names them, or the one for all others."""
    return next((i for i, names in enumerate(platforms) if names and "cpu" in names), len(platforms) - 1)


def _is_short(parameters: dict, inputs: list[Value]) -> bool:
    carried, count = parameters["num_carry"], parameters["num_consts"]
    body = parameters["jaxpr"].jaxpr
    # `length` consumed arrays are written out only where they are known.
    known = all(x.constant is not None for x in inputs[count + carried :])
    return parameters["length"] <= TURNS and len(body.eqns) <= BODY and len(body.outvars) == carried and known


def _used(equations: list[Equation], outputs: list[Value]) -> list[Equation]:
    """The equations that the outputs need."""
    needed, kept = set(map(id, outputs)), []
    for equation in reversed(equations):
        if equation.acts or any(id(value) in needed for value in equation.outputs):
            kept.append(equation)
            needed |= set(map(id, equation.inputs))
    return kept[::-1]


def small_constant(array: Any) -> np.ndarray | None:
    """A concrete small array of numbers as NumPy has it; None for others."""
    if isinstance(array, Tracer) or not jnp.issubdtype(jnp.result_type(array), jnp.number):
        return None
    return np.asarray(array) if np.size(array) <= SMALL else None


def most_products(closed: core.ClosedJaxpr) -> int:
    """The largest number of products of one multiplication, also in calls, loops and branches."""
    found, jaxprs = 0, [closed.jaxpr]
    while jaxprs:
        for equation in jaxprs.pop().eqns:
            if equation.primitive.name == "mul":
                found = max(found, math.prod(equation.outvars[0].aval.shape))
            for value in equation.params.values():
                parts = value if isinstance(value, tuple) else (value,)
                jaxprs += [part.jaxpr for part in parts if isinstance(part, core.ClosedJaxpr)]
                jaxprs += [part for part in parts if isinstance(part, core.Jaxpr)]
    return found
