"""The C++ text of a kernel. It depends on operations and components, never on numbers of rows or on values.

A kernel reads `tables` and small arrays whole, and its rows from arrays [rows] of one component each, or from whole
arrays. It writes components, whole arrays, and sums.
"""

import math
import re
from collections.abc import Container, Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np

from jaxdr.kernels.flatten import Equation, Value
from jaxdr.kernels.machine import TYPES, library_text
from jaxdr.kernels.operations import SCALARS, VECTORS, Components, computed, literal, rearranged
from jaxdr.kernels.rows import components, is_sum, row_axis, width

_NEEDS_NO_NAME = re.compile(r"x\d+|[FIUB]\([-+.\w]*\)")  # names and literals


class Part(NamedTuple):
    """One component of an array with rows, or the array as a whole."""

    value: Value
    component: int | None = None


class Kernel(NamedTuple):
    """A kernel and its operands: `reads`, then results: `writes`, then `sums`."""

    rows: int
    text: str
    reads: list[Part]
    writes: list[Part]
    sums: list[Equation]


class KernelWriter:
    """Writes the kernel of some equations; its `reads` are known before what it writes is.

    `free` equations are repeated where they are needed. Components of values in `apart` are there one by one;
    those in `made` come from other kernels, which write them by component, as a whole, or both. The equations of values
    in `placed` do nothing but place components of others, which are read in their stead.
    """

    def __init__(
        self,
        rows: int,
        equations: Sequence[Equation],
        free: Mapping[Value, Equation],
        apart: Container[Value],
        made: Container[Value],
        placed: Mapping[Value, Equation],
    ):
        self.rows, self.equations, self.free, self.apart, self.made = rows, equations, free, apart, made
        self.placed = placed
        self.known: dict[Value, Components] = {}
        self.loaded: dict[Part, str] = {}
        self.reads: list[Part] = []
        self.places: dict[Part, int] = {}
        self.before: list[str] = []
        self.lines: list[str] = []
        self.after: list[str] = []
        self.count = 0
        self.sums: list[Equation] = []
        for equation in equations:
            if is_sum(equation):
                self.sums.append(equation)
                self.add_up(equation, len(self.sums) - 1)
            else:
                self.compute(equation)

    def finished(self, by_component: Mapping[Value, set[int]], whole: Container[Value]) -> Kernel:
        """The kernel, which writes the components and whole values that others need."""
        writes = []
        for value in (v for e in self.equations if not is_sum(e) for v in e.outputs):
            numbers: list[int | None] = [*sorted(by_component.get(value, ()))]
            for number in [*numbers, None] if value in whole else numbers:
                self.write(value, number, len(writes))
                writes.append(Part(value, number))
        return Kernel(self.rows, self.text(len(writes)), self.reads, writes, self.sums)

    def named(self, vector: str, expression: str, before: bool = False) -> str:
        if _NEEDS_NO_NAME.fullmatch(expression):
            return expression
        self.count += 1
        (self.before if before else self.lines).append(f"const {vector} x{self.count} = {expression};")
        return f"x{self.count}"

    def place(self, part: Part) -> int:
        """The number of an operand."""
        if part not in self.places:
            self.places[part] = len(self.reads)
            self.reads.append(part)
        return self.places[part]

    def components_of(self, value: Value) -> Components:
        if value not in self.known:
            self.known[value] = self.read(value)
        return self.known[value]

    def read(self, value: Value) -> Components:
        vector, scalar = VECTORS[value.kind], SCALARS[value.kind]
        if value.constant is not None and row_axis(value.shape, self.rows) is None:
            return [literal(x, value.kind) for x in value.constant.ravel()]
        if value in self.free:
            equation = self.free[value]
            self.compute(equation)
            return self.known[value]
        axis = row_axis(value.shape, self.rows)
        if axis is None:
            p = self.place(Part(value))
            load = "B(p[{}] ? -1 : 0)" if vector == "B" else vector + "(p[{}])"
            pointer = f"((const {scalar}*)P[{p}])"
            return [self.named(vector, load.replace("p[", pointer + "[").format(i), True) for i in range(value.size)]
        if value in self.apart:
            return [self.component(part) for part in self.sources(value)]
        p, inner = self.place(Part(value)), math.prod(value.shape[axis + 1 :])
        found = []
        for i in range(width(value, self.rows)):
            start = _start(f"(const {scalar}*)P[{p}]", i, inner)
            form = (
                f"load_{vector}({start})" if inner == 1 else f"gather_{vector}({start}, placed(lanes() * I({inner})))"
            )
            found.append(self.named(vector, form))
        return found

    def sources(self, value: Value) -> list[Part]:
        """The components of a value, or those of other values of which it consists."""
        own = [Part(value, i) for i in range(width(value, self.rows))]
        equation = self.placed.get(value)
        if equation is None or any(v not in self.apart for v in equation.inputs):
            return own
        found = rearranged(equation, self.rows, [self.sources(v) for v in equation.inputs])
        return found[equation.outputs.index(value)]

    def component(self, part: Part) -> str:
        value, number = part
        assert number is not None
        if value in self.known:
            return self.known[value][number]
        if part not in self.loaded:
            vector, scalar = VECTORS[value.kind], SCALARS[value.kind]
            load = f"load_{vector}((const {scalar}*)P[{self.place(part)}] + at)"
            self.loaded[part] = self.named(vector, load)
        return self.loaded[part]

    def compute(self, equation: Equation) -> None:
        """Write lines for an equation, and remember its results."""
        if equation.name == "gather":
            results = [self.lookup(equation)]
        elif equation.name == "iota":
            results = [self.counted(equation)]
        elif equation.name == "random_bits":
            results = [self.drawn(equation)]
        else:
            given = [self.components_of(v) for v in equation.inputs]
            results = computed(equation, self.rows, given)
        for value, expressions in zip(equation.outputs, results, strict=True):
            vector = VECTORS[value.kind]
            self.known[value] = [self.named(vector, e) for e in expressions]

    def counted(self, equation: Equation) -> Components:
        out, dimension = equation.outputs[0], equation.parameters["dimension"]
        vector = VECTORS[out.kind]
        if dimension == row_axis(out.shape, self.rows):
            index = "lanes() + I((int)at)"
            return [f"({index})" if vector == "I" else f"to_{vector}({index})"] * width(out, self.rows)
        shape = components(out, self.rows)
        numbers = np.broadcast_to(
            np.arange(shape[dimension]).reshape([-1 if d == dimension else 1 for d in range(len(shape))]), shape
        )
        return [literal(x, out.kind) for x in numbers.ravel()]

    def drawn(self, equation: Equation) -> Components:
        """Random bits: threefry of the key and the place in the array, as JAX draws them."""
        (key,), (out,) = equation.inputs, equation.outputs
        p, axis = self.place(Part(key)), row_axis(out.shape, self.rows)
        assert axis is not None
        words = ", ".join(self.named("U", f"U(((const unsigned*)P[{p}])[{i}])", True) for i in (0, 1))
        inner = math.prod(out.shape[axis + 1 :])
        found = []
        for i in range(width(out, self.rows)):
            outer, rest = divmod(i, inner)
            start = f"(unsigned)({f'{outer} * rows + ' if outer else ''}at) * {inner}u + {rest}u"
            found.append(f"v_threefry({words}, to_U(lanes()) * U({inner}u) + U({start}))")
        return found

    def lookup(self, equation: Equation) -> Components:
        """Entries of a table, at indices that are clipped to it."""
        table, index = equation.inputs
        vector, scalar = VECTORS[table.kind], SCALARS[table.kind]
        indexed = len(equation.parameters["dimension_numbers"].start_index_map)
        inner = math.prod(table.shape[indexed:])
        given = np.array(self.components_of(index), object).reshape(-1, indexed)
        one_by_one = (
            table in self.apart
            and table not in self.made
            and row_axis(table.shape, max(table.shape)) == 0
            and indexed == 1
        )
        whole = None if one_by_one else self.place(Part(table))
        first = self.place(Part(table, 0)) if whole is None else whole
        found = []
        for numbers in given:
            clipped, inside = [], []
            for d, number in enumerate(numbers):
                entry, fits = self.clipped(number, index.kind, f"D[{first}][{d}]")
                clipped.append(entry)
                inside.append(fits)
            place = clipped[0]
            for d, entry in enumerate(clipped[1:], 1):
                place = f"({place} * I((int)D[{first}][{d}]) + {entry})"
            if inner > 1 and whole is not None:
                place = f"{place} * I({inner})"
            place = self.named("Places", f"placed({place})")
            for i in range(inner):
                p, offset = (self.place(Part(table, i)), "") if whole is None else (whole, f" + {i}" if i else "")
                entry = f"gather_{vector}((const {scalar}*)P[{p}]{offset}, {place})"
                if equation.parameters["mode"] == jax.lax.GatherScatterMode.FILL_OR_DROP:
                    entry = f"v_select({' & '.join(inside)}, {entry}, {self.filler(equation, table)})"
                found.append(entry)
        return found

    def filler(self, equation: Equation, table: Value) -> str:
        fill = equation.parameters["fill_value"]
        if fill is None:
            fill = {"float32": np.nan, "int32": -(2**31), "uint32": 2**32 - 1, "bool": True}[table.kind]
        return literal(fill, table.kind)

    def clipped(self, number: str, kind: str, length: str) -> tuple[str, str]:
        """(an index clipped to a length, whether it needed no clipping)."""
        last = f"I((int)({length} - 1))"
        if kind == "uint32":
            return f"(I)v_min({number}, (U){last})", f"({number} <= (U){last})"
        entry = self.named("I", f"v_min(v_max({number}, I(0)), {last})")
        return entry, f"({entry} == {number})"

    def add_up(self, equation: Equation, number: int) -> None:
        """Write lines for sums over rows. The last rows of a kernel may have been computed twice: `live` are new."""
        out = equation.outputs[0]
        vector, scalar = VECTORS[out.kind], SCALARS[out.kind]
        if equation.name == "reduce_sum":
            axis = row_axis(equation.inputs[0].shape, self.rows)
            within = tuple(a for a in equation.parameters["axes"] if a != axis)
            given = np.array(self.components_of(equation.inputs[0]), object).reshape(
                components(equation.inputs[0], self.rows)
            )
            parts = np.moveaxis(given, within, range(-len(within), 0)).reshape(max(out.size, 1), -1)
            for i, terms in enumerate(parts):
                self.before.append(f"{vector} total{number}_{i} = {vector}(0);")
                self.lines.append(f"total{number}_{i} += v_select(live, {' + '.join(terms)}, {vector}(0));")
                self.after.append(f"S[{number}].{scalar}s[{i}] += total_{vector}(total{number}_{i});")
            return
        _, index, update = equation.inputs
        inner = math.prod(out.shape[1:])
        terms = np.array(self.components_of(update), object).reshape(-1, inner)
        drop = equation.parameters["mode"] == jax.lax.GatherScatterMode.FILL_OR_DROP
        for entry, values in zip(self.components_of(index), terms, strict=True):
            clipped, fits = self.clipped(entry, index.kind, f"T[{number}]")
            place = self.named("I", f"{clipped} * I({inner})" if inner > 1 else clipped)
            counts = self.named("B", f"live & {fits}" if drop else "live")
            for i, value in enumerate(values):
                self.lines.append(
                    f"add_{vector}(S[{number}].{scalar}s + {i}, {place}, v_select({counts}, {value}, {vector}(0)));"
                )

    def write(self, value: Value, component: int | None, number: int) -> None:
        vector, scalar = VECTORS[value.kind], SCALARS[value.kind]
        names, pointer = self.components_of(value), f"({scalar}*)R[{number}]"
        if component is not None:
            self.lines.append(f"store_{vector}({pointer} + at, {names[component]});")
            return
        axis = row_axis(value.shape, self.rows)
        assert axis is not None
        inner = math.prod(value.shape[axis + 1 :])
        for i, name in enumerate(names):
            start = _start(pointer, i, inner)
            form = f"store_{vector}({start}, {name});" if inner == 1 else f"scatter_{vector}({start}, {inner}, {name});"
            self.lines.append(form)

    def text(self, writes: int) -> str:
        """All lines, with those that every kernel has."""
        kinds = [*("true" if e.outputs[0].kind == "int32" else "false" for e in self.sums), "false"]
        return "\n".join(
            [
                TYPES,
                library_text("kernel.h"),
                library_text("vector.h"),
                f"#define READS {len(self.reads)}",
                f"#define WRITES {writes}",
                f"#define SUMS {len(self.sums)}",
                f"static const bool WHOLE[SUMS + 1] = {{{', '.join(kinds)}}};",
                "static void body(const char* const* P, const int64_t* const* D, char* const* R, Sums* S,",
                "                 const int64_t* T, int64_t rows, int64_t start, int64_t end) {",
                *self.before,
                "for (int64_t b = start; b < end; b += WIDTH) {",
                "const int64_t at = b + WIDTH <= rows ? b : rows - WIDTH;",
                "const B live = lanes() + I((int)(at - b)) >= I(0);",
                *self.lines,
                "}",
                *self.after,
                "}",
                library_text("handler.h"),
            ]
        )


def _start(pointer: str, component: int, inner: int) -> str:
    """The address of a component of the first row, in a whole array with `inner` numbers after the axis of rows."""
    outer, rest = divmod(component, inner)
    return f"{pointer} + ({f'{outer} * rows + ' if outer else ''}at) * {inner}L + {rest}"
