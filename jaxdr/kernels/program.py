"""Programs of kernels: what is computed by kernels, what is left to XLA, and which arrays go between them.

Between kernels a value with rows is one array a component. Loops and branches carry such values in the same way.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from jaxdr.kernels import machine
from jaxdr.kernels.flatten import Equation, Value, flat
from jaxdr.kernels.handled import handled, has_handler, target_of
from jaxdr.kernels.levels import Cluster, planned
from jaxdr.kernels.rows import KINDS, LEAST, STRUCTURAL, THREEFRY, changes_entries, is_sum, row_axis, width
from jaxdr.kernels.text import Kernel, KernelWriter, Part

LOOPS = ("scan", "while", "cond")
WIDEST = 16  # components; wider values go through loops as a whole
# Operations of XLA that move rows, and do the same to every component.
BY_COMPONENT = ("dynamic_slice", "dynamic_update_slice", "slice", "concatenate", "pad")
INTO_ROWS = {"scatter-add": jax.lax.scatter_add, "scatter": jax.lax.scatter}


class Counts:
    """What a program consists of: names of its kernels, operations in them, and operations left to XLA by name."""

    def __init__(self):
        self.targets: list[str] = []
        self.fused = 0
        self.left: dict[str, int] = {}


class _Call(NamedTuple):
    """A step: the kernel with this name."""

    target: str
    kernel: Kernel


class _Loop(NamedTuple):
    """A step: a loop or branch with programs for its bodies. `apart`: which inputs and outputs come by component."""

    equation: Equation
    programs: list["Program"]
    apart: tuple[bool, ...]
    apart_out: tuple[bool, ...]


class _Handled(NamedTuple):
    """A step: an operation with a handler of its own, with this name."""

    target: str
    equation: Equation


class _Moved(NamedTuple):
    """A step: an operation of XLA on every component."""

    equation: Equation


class Program:
    """A jaxpr as steps. Called with a list of arrays for each input, it returns one for each output.

    A list has an array for each component of a value where `apart` says so, and else one array.
    """

    def __init__(
        self,
        closed: core.ClosedJaxpr,
        counts: Counts,
        known: Sequence[Any],
        apart: Sequence[bool],
        apart_out: Sequence[bool],
    ):
        self.inputs, equations, self.outputs = flat(closed, known)
        self.given, self.returned = tuple(apart), tuple(apart_out)
        plan = planned(equations)
        self.free = plan.free
        self.apart = {v for v, a in zip(self.inputs, apart, strict=True) if a}
        made: set[Value] = set()
        placed: dict[Value, Equation] = {}
        steps: list[Any] = []
        for step in plan.steps:
            if isinstance(step, Cluster):
                writer = KernelWriter(step.rows, step.equations, plan.free, self.apart, made, placed)
                placed |= {v: e for e in step.equations if e.name in STRUCTURAL for v in e.outputs}
                made |= {v for e in step.equations if not is_sum(e) for v in e.outputs}
                self.apart |= made
                steps.append(writer)
                continue
            if has_handler(step):
                counts.targets.append(target_of(step))
                steps.append(_Handled(counts.targets[-1], step))
                continue
            counts.left[step.name] = counts.left.get(step.name, 0) + 1
            if step.name in LOOPS:
                loop = _loop(step, counts, self.apart - made)
                self.apart |= {v for v, a in zip(step.outputs, loop.apart_out, strict=True) if a}
                steps.append(loop)
            elif _moves_rows(step, self.apart):
                self.apart |= set(step.outputs)
                steps.append(_Moved(step))
            else:
                steps.append(step)
        needed = [part for step in steps for part in _needs(step)]
        needed += [part for v, a in zip(self.outputs, apart_out, strict=True) for part in _parts(v, a)]
        by_component: dict[Value, set[int]] = {}
        for value, number in needed:
            if number is not None:
                by_component.setdefault(value, set()).add(number)
        whole = {part.value for part in needed if part.component is None}
        # What XLA makes of repeated operations, it makes of whole arrays.
        whole |= {v for e in plan.free.values() for v in e.inputs}
        self.steps = [
            _call(step, counts, by_component, whole) if isinstance(step, KernelWriter) else step for step in steps
        ]

    def __call__(self, operands: Sequence[list[Any]]) -> list[list[Any]]:
        arrays = _Arrays(self)
        for value, given, by_component in zip(self.inputs, operands, self.given, strict=True):
            if by_component:
                arrays.parts[value] = dict(enumerate(given))
            else:
                arrays.arrays[value] = given[0]
        for step in self.steps:
            _run(step, arrays)
        return [
            arrays.components(v) if a else [arrays.whole(v)] for v, a in zip(self.outputs, self.returned, strict=True)
        ]


def _call(writer: KernelWriter, counts: Counts, by_component: dict[Value, set[int]], whole: set[Value]) -> _Call:
    kernel = writer.finished(by_component, whole)
    counts.fused += len(writer.equations)
    counts.targets.append(machine.target(kernel.text))
    return _Call(counts.targets[-1], kernel)


def _parts(value: Value, by_component: bool) -> list[Part]:
    """All components of a value, or the value as a whole."""
    return [Part(value, i) for i in range(width(value, max(value.shape)))] if by_component else [Part(value)]


def _needs(step: Any) -> list[Part]:
    """What a step reads."""
    if isinstance(step, KernelWriter):
        return [*step.reads, *(Part(e.inputs[0]) for e in step.sums if e.name == "scatter-add")]
    if isinstance(step, _Loop):
        return [p for v, a in zip(step.equation.inputs, step.apart, strict=True) for p in _parts(v, a)]
    if isinstance(step, _Moved):
        return [p for v in step.equation.inputs for p in _parts(v, bool(v.shape))]
    return [Part(v) for v in (step.equation if isinstance(step, _Handled) else step).inputs]


class _Arrays:
    """Arrays of values while a program runs: as a whole, by component, or both."""

    def __init__(self, program: Program):
        self.program = program
        self.arrays: dict[Value, Any] = {}
        self.parts: dict[Value, dict[int, Any]] = {}

    def whole(self, value: Value) -> Any:
        if value.constant is not None:
            return jnp.asarray(value.constant)
        if value not in self.arrays:
            self.arrays[value] = self._made(value)
        return self.arrays[value]

    def _made(self, value: Value) -> Any:
        if value in self.parts:
            shape = value.shape
            axis = row_axis(shape, max(shape))
            assert axis is not None
            table = jnp.stack(self.components(value), -1)
            others = [n for d, n in enumerate(shape) if d != axis]
            return jnp.moveaxis(table.reshape(shape[axis], *others), 0, axis)
        equation = self.program.free[value]
        return _bind(equation, [self.whole(v) for v in equation.inputs])[equation.outputs.index(value)]

    def components(self, value: Value) -> list[Any]:
        if value not in self.parts:
            array = self.whole(value)
            rows = max(value.shape)
            axis = row_axis(value.shape, rows)
            assert axis is not None
            table = jnp.moveaxis(array, axis, 0).reshape(rows, -1)
            self.parts[value] = {i: table[:, i] for i in range(table.shape[1])}
        return [self.parts[value][i] for i in range(len(self.parts[value]))]

    def part(self, part: Part) -> Any:
        if part.value.kind == THREEFRY:
            return jax.random.key_data(self.whole(part.value))
        if part.component is None:
            return self.whole(part.value)
        known = self.parts.get(part.value, {})
        return known[part.component] if part.component in known else self.components(part.value)[part.component]


def _bind(equation: Equation, operands: list[Any]) -> list[Any]:
    primitive = equation.primitive
    results = primitive.bind(*operands, **primitive.get_bind_params(equation.parameters))
    return results if primitive.multiple_results else [results]


def _run(step: Any, arrays: _Arrays) -> None:
    """Do a step, and keep its results."""
    if isinstance(step, _Call):
        _run_kernel(step, arrays)
    elif isinstance(step, _Loop):
        results = _run_loop(step, arrays)
        for value, result, by_component in zip(step.equation.outputs, results, step.apart_out, strict=True):
            if by_component:
                arrays.parts[value] = dict(enumerate(result))
            else:
                arrays.arrays[value] = result[0]
    elif isinstance(step, _Handled):
        (out,) = step.equation.outputs
        arrays.arrays[out] = handled(step.target, step.equation, [arrays.whole(v) for v in step.equation.inputs])
    elif isinstance(step, _Moved):
        (out,) = step.equation.outputs
        arrays.parts[out] = dict(enumerate(_moved(step.equation, arrays)))
    else:
        results = _bind(step, [arrays.whole(v) for v in step.inputs])
        arrays.arrays |= dict(zip(step.outputs, results, strict=True))


def _run_kernel(call: _Call, arrays: _Arrays) -> None:
    kernel = call.kernel
    kinds = [
        jax.ShapeDtypeStruct(p.value.shape if p.component is None else (kernel.rows,), p.value.aval.dtype)
        for p in kernel.writes
    ]
    totals = [jax.ShapeDtypeStruct(e.outputs[0].shape, e.outputs[0].aval.dtype) for e in kernel.sums]
    run = jax.ffi.ffi_call(call.target, [*kinds, *totals])
    results = run(*(arrays.part(p) for p in kernel.reads), rows=np.int64(kernel.rows))
    for part, result in zip(kernel.writes, results, strict=False):
        if part.component is None:
            arrays.arrays[part.value] = result
        else:
            arrays.parts.setdefault(part.value, {})[part.component] = result
    for equation, total in zip(kernel.sums, results[len(kinds) :], strict=True):
        if equation.name == "scatter-add":
            total = arrays.whole(equation.inputs[0]) + total
        arrays.arrays[equation.outputs[0]] = total


def _moves_rows(equation: Equation, apart: set[Value]) -> bool:
    """Whether an operation does the same to every component of rows, some of which are there one by one."""
    if equation.name in INTO_ROWS:
        table, index, _ = equation.inputs
        by_row = all(v.shape and v.size and row_axis(v.shape, max(v.shape)) == 0 for v in equation.inputs)
        return table in apart and by_row and len(index.shape) == 2 and changes_entries(equation)
    if equation.name not in BY_COMPONENT or not any(v in apart for v in equation.inputs):
        return False
    given = [v for v in equation.inputs if v.shape]
    if any(not v.size for v in given):
        return False
    (out,) = equation.outputs
    inner = out.shape[1:]
    if any(v.shape[1:] != inner or row_axis(v.shape, max(v.shape)) != 0 for v in (*given, out)):
        return False
    parameters = equation.parameters
    match equation.name:
        case "concatenate":
            return int(parameters["dimension"]) == 0
        case "slice":
            return True  # other axes keep their lengths
        case "pad":
            return all(tuple(map(int, p)) == (0, 0, 0) for p in parameters["padding_config"][1:])
        case _:
            return True


def _moved(equation: Equation, arrays: _Arrays) -> list[Any]:
    parameters, (out,) = equation.parameters, equation.outputs
    parts = [arrays.components(v) if v.shape else [arrays.whole(v)] for v in equation.inputs]
    found = []
    for i in range(math.prod(out.shape[1:])):
        given = [p[i] if len(p) > 1 else p[0] for p in parts]  # a scalar or index is for all components
        match equation.name:
            case "concatenate":
                found.append(jnp.concatenate(given))
            case "slice":
                strides = parameters["strides"] or (1,)
                start, limit = parameters["start_indices"][0], parameters["limit_indices"][0]
                found.append(jax.lax.slice(given[0], (start,), (limit,), (strides[0],)))
            case "pad":
                before, after, inside = map(int, parameters["padding_config"][0])
                found.append(jax.lax.pad(given[0], given[1], [(before, after, inside)]))
            case "scatter" | "scatter-add":
                numbers = jax.lax.ScatterDimensionNumbers((), (0,), (0,))
                table, index, rows = given
                found.append(
                    INTO_ROWS[equation.name](
                        table,
                        index[:, None],
                        rows,
                        numbers,
                        indices_are_sorted=parameters["indices_are_sorted"],
                        unique_indices=parameters["unique_indices"],
                        mode=parameters["mode"],
                    )
                )
            case "dynamic_slice":
                found.append(jax.lax.dynamic_slice(given[0], (given[1],), (out.shape[0],)))
            case _:
                found.append(jax.lax.dynamic_update_slice(given[0], given[1], (given[2],)))
    return found


def _goes_apart(value: Value) -> bool:
    """Whether a loop carries a value by component."""
    rows = max(value.shape, default=0)
    return (
        value.kind in KINDS
        and len(value.shape) > 1
        and rows >= LEAST
        and row_axis(value.shape, rows) is not None
        and 1 < width(value, rows) <= WIDEST
    )


def _is_batched(equation: Equation) -> bool:
    """Whether a `while` is many loops, by `vmap`: each goes on by its own test, along the first axes of all values."""
    return bool(equation.parameters["cond_jaxpr"].out_avals[0].shape)


def _loop(equation: Equation, counts: Counts, apart: set[Value]) -> _Loop:
    parameters, inputs, outputs = equation.parameters, equation.inputs, equation.outputs
    known = [v.constant for v in inputs]
    if equation.name == "scan":
        constants, carried = parameters["num_consts"], parameters["num_carry"]
        carries = [_goes_apart(v) for v in outputs[:carried]]
        given = [*(v in apart for v in inputs[:constants]), *carries]
        given += [False] * (len(inputs) - len(given))
        returned = (*carries, *[False] * (len(outputs) - carried))
        fixed = known[:constants] + [None] * (len(inputs) - constants)
        return _Loop(equation, [Program(parameters["jaxpr"], counts, fixed, given, returned)], tuple(given), returned)
    if equation.name == "while":
        a, b = parameters["cond_nconsts"], parameters["body_nconsts"]
        carries = [not _is_batched(equation) and _goes_apart(v) for v in outputs]
        given = [*(v in apart for v in inputs[: a + b]), *carries]
        nothing = [None] * len(outputs)
        test = Program(parameters["cond_jaxpr"], counts, known[:a] + nothing, given[:a] + carries, [False])
        body = Program(parameters["body_jaxpr"], counts, known[a : a + b] + nothing, given[a:], carries)
        return _Loop(equation, [test, body], tuple(given), tuple(carries))
    given = [v in apart for v in inputs]
    # Branches hand on much of what they were given, and loops collect what branches return: both as a whole.
    returned = (False,) * len(outputs)
    programs = [Program(branch, counts, known[1:], given[1:], returned) for branch in parameters["branches"]]
    return _Loop(equation, programs, tuple(given), returned)


def _run_loop(loop: _Loop, arrays: _Arrays) -> list[list[Any]]:
    equation, parameters = loop.equation, loop.equation.parameters
    given = [arrays.components(v) if a else [arrays.whole(v)] for v, a in zip(equation.inputs, loop.apart, strict=True)]
    if equation.name == "scan":
        constants, carried = parameters["num_consts"], parameters["num_carry"]

        def turn(carry, xs):
            results = loop.programs[0]([*given[:constants], *carry, *([x] for x in xs)])
            return results[:carried], [r[0] for r in results[carried:]]

        carry, ys = jax.lax.scan(
            turn,
            given[constants : constants + carried],
            [x[0] for x in given[constants + carried :]],
            length=parameters["length"],
            reverse=parameters["reverse"],
            unroll=parameters["unroll"],
        )
        return [*carry, *([y] for y in ys)]
    if equation.name == "while":
        a, b = parameters["cond_nconsts"], parameters["body_nconsts"]
        test, body = loop.programs

        def goes_on(state):
            return test([*given[:a], *state])[0][0]

        def turned(state):
            return body([*given[a : a + b], *state])

        if not _is_batched(equation):
            return jax.lax.while_loop(goes_on, turned, given[a + b :])

        def turned_where_it_goes_on(state):
            going = goes_on(state)
            kept = [jnp.expand_dims(going, tuple(range(going.ndim, old.ndim))) for (old,) in state]
            return [[jnp.where(k, new, old)] for k, (new,), (old,) in zip(kept, turned(state), state, strict=True)]

        return jax.lax.while_loop(lambda state: goes_on(state).any(), turned_where_it_goes_on, given[a + b :])
    branches: list[Callable] = [lambda *x, p=p: p(list(x)) for p in loop.programs]
    return jax.lax.switch(given[0][0], branches, *given[1:])
