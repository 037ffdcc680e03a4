"""Which equations become one kernel, and in which order everything is computed.

Every equation has a level. Row-wise equations of one level and one number of rows are a kernel. A kernel's level is
above those of the sums, of the tables that it reads at computed indices, of all that XLA computes for it, and of
kernels with other numbers of rows. So whatever a kernel needs is there when it starts.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxdr.kernels.flatten import SMALL, Equation, Value
from jaxdr.kernels.operations import has_rule
from jaxdr.kernels.rows import KINDS, STRUCTURAL, is_sum, row_axis, rows_of


class Cluster(NamedTuple):
    """The equations of a kernel, in order."""

    rows: int
    equations: list[Equation]


class Plan(NamedTuple):
    """Steps in order. `free` equations are repeated where they are needed: they cost less than to be kept."""

    steps: list[Cluster | Equation]
    free: dict[Value, Equation]


def planned(equations: Sequence[Equation]) -> Plan:
    """The plan for a list of equations."""
    makers: dict[Value, Equation] = {}
    level: dict[Equation, int] = {}
    rows: dict[Equation, int] = {}
    free: dict[Value, Equation] = {}
    clusters: dict[tuple[int, int], Cluster] = {}
    others: dict[int, list[Equation]] = {}
    for equation in equations:
        rows[equation] = _rows(equation)
        level[equation] = max(
            (_above(equation, i, v, makers, level, rows, free) for i, v in enumerate(equation.inputs)), default=0
        )
        makers |= dict.fromkeys(equation.outputs, equation)
        if _is_free(equation, rows[equation]):
            free |= dict.fromkeys(equation.outputs, equation)
        elif rows[equation]:
            key = level[equation], rows[equation]
            clusters.setdefault(key, Cluster(rows[equation], [])).equations.append(equation)
        else:
            others.setdefault(level[equation], []).append(equation)
    steps: list[Cluster | Equation] = []
    for now in sorted({*others, *(at for at, _ in clusters)}):
        steps += [cluster for (at, _), cluster in clusters.items() if at == now]
        steps += others.get(now, [])
    return Plan(steps, free)


def _rows(equation: Equation) -> int:
    rows = rows_of(equation)
    if not rows or is_sum(equation) or equation.name in ("gather", "iota", "random_bits"):
        return rows
    return rows if has_rule(equation) else 0


def _is_free(equation: Equation, rows: int) -> bool:
    """Whether rows are made of nothing but a few numbers that all share, or these numbers are only placed anew."""
    if not rows:
        return equation.name in STRUCTURAL and all(
            v.size <= SMALL and v.kind in KINDS for v in (*equation.inputs, *equation.outputs)
        )
    if is_sum(equation) or equation.name in ("gather", "random_bits"):
        return False
    return all(row_axis(v.shape, rows) is None for v in equation.inputs)


def _above(equation, position: int, value: Value, makers, level, rows, free) -> int:
    """The least level of an equation that reads this value."""
    maker = makers.get(value)
    if maker is None:
        return 0
    at = level[maker]
    if value in free:
        return at + 1 if rows[equation] and not rows[maker] else at
    if not rows[equation]:
        return at + 1 if rows[maker] else at
    is_table = equation.name == "gather" and position == 0
    return at if rows[maker] == rows[equation] and not is_table and not is_sum(maker) else at + 1
