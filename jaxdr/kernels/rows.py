"""Which equations are arithmetic on rows: what they compute for a row depends on this row and on tables alone.

An array has rows along one axis, its longest; the other axes are the components of a row. An array [2, 65536, 3] has
65,536 rows with six components each.
"""

import math

import jax
from jax.lax import GatherScatterMode

from jaxdr.kernels.flatten import SMALL, Equation, Value

LEAST = 512  # rows; fewer are left to XLA
KINDS = {"float32", "int32", "uint32", "bool"}
THREEFRY = "key<fry>"  # the type of JAX's default keys
SUMMED = 1 << 15  # numbers in a table: each task has its own, so sums into larger tables are left to XLA
# Operations on components, each by its own rule in `operations`.
ELEMENTWISE = frozenset(
    "add sub mul div add_any max min rem and or xor lt gt le ge eq ne lt_to le_to shift_left shift_right_logical "
    "shift_right_arithmetic pow atan2 neg not abs sign sqrt rsqrt square exp exp2 log log1p expm1 sin cos tan tanh "
    "asin acos atan logistic erf cbrt floor ceil round integer_pow is_finite clamp convert_element_type "
    "bitcast_convert_type select_n copy copy_p".split()
)
STRUCTURAL = frozenset(
    "broadcast_in_dim reshape squeeze expand_dims unstack stack concatenate split slice pad transpose rev".split()
)
REDUCTIONS = frozenset("reduce_sum reduce_prod reduce_max reduce_min reduce_or reduce_and".split())


def row_axis(shape: tuple[int, ...], rows: int) -> int | None:
    """The axis along which an array has that many rows; None if there is not exactly one."""
    return shape.index(rows) if shape.count(rows) == 1 else None


def components(value: Value, rows: int) -> tuple[int, ...]:
    """The array's shape with one row; that of an array without rows is its own."""
    axis = row_axis(value.shape, rows)
    return value.shape if axis is None else (*value.shape[:axis], 1, *value.shape[axis + 1 :])


def width(value: Value, rows: int) -> int:
    """Number of components."""
    return math.prod(components(value, rows))


def rows_of(equation: Equation) -> int:
    """The number of rows of a row-wise equation, and 0 for all others."""
    if equation.name == "random_bits":
        return _rows_of_bits(equation)
    if equation.acts or any(v.kind not in KINDS or not v.size for v in (*equation.inputs, *equation.outputs)):
        return 0
    if is_sum(equation):
        return max(equation.inputs[-1].shape)
    shape = equation.outputs[0].shape
    rows = max(shape, default=0)
    if rows < LEAST or any(row_axis(v.shape, rows) is None or width(v, rows) > SMALL for v in equation.outputs):
        return 0
    name = equation.name
    if name == "gather":
        return rows if _is_lookup(equation, rows) else 0
    if name == "iota":
        return rows
    if name == "dot_general":
        return rows if _is_dot_of_rows(equation, rows) else 0
    if name not in ELEMENTWISE and name not in STRUCTURAL and name not in REDUCTIONS:
        return 0
    if any(not _is_read_by_row(v, rows) for v in equation.inputs):
        return 0
    return rows if _keeps_rows_apart(equation, rows) else 0


def _rows_of_bits(equation: Equation) -> int:
    """The number of rows of random bits that kernels have: those of one threefry key, numbered in order."""
    (key,), (out,) = equation.inputs, equation.outputs
    rows = max(out.shape, default=0)
    has_rows = rows >= LEAST and row_axis(out.shape, rows) is not None and width(out, rows) <= SMALL
    is_known = key.kind == THREEFRY and not key.shape and out.kind == "uint32" and out.size < 1 << 32
    return rows if has_rows and is_known and jax.config.jax_threefry_partitionable else 0  # type: ignore[reportAttributeAccessIssue]


def _is_read_by_row(value: Value, rows: int) -> bool:
    """Whether a row has its own components of the array, or all rows read the same few numbers."""
    return width(value, rows) <= SMALL and (row_axis(value.shape, rows) is not None or value.size <= SMALL)


def _keeps_rows_apart(equation: Equation, rows: int) -> bool:
    """Whether an operation with the right shapes leaves every row where it is."""
    name, parameters = equation.name, equation.parameters
    first, out = equation.inputs[0], equation.outputs[0]
    axis, after = row_axis(first.shape, rows), row_axis(out.shape, rows)
    assert after is not None
    if name in ELEMENTWISE:
        # JAX broadcasts axes of length one. An array without rows has one row, or none at all.
        return all(
            not v.shape or row_axis(v.shape, rows) == after or (len(v.shape) == len(out.shape) and v.shape[after] == 1)
            for v in equation.inputs
        )
    has_rows = all(row_axis(v.shape, rows) is not None for v in equation.inputs)
    if name == "broadcast_in_dim":
        return axis is None or int(parameters["broadcast_dimensions"][axis]) == after
    if name == "stack":
        return int(parameters["axis"]) != after and has_rows
    if name == "concatenate":
        return int(parameters["dimension"]) != after and has_rows
    if axis is None:
        return False
    before = math.prod(first.shape[:axis])
    match name:
        case "reshape":
            # Same order in memory: as many numbers before the axis as after, or rows come first in both.
            return parameters.get("dimensions") is None and before == math.prod(out.shape[:after])
        case "unstack" | "split":
            return int(parameters["axis"]) != axis
        case "slice":
            strides = parameters["strides"] or (1,) * len(first.shape)
            return (parameters["start_indices"][axis], parameters["limit_indices"][axis], strides[axis]) == (0, rows, 1)
        case "pad":
            return tuple(map(int, parameters["padding_config"][axis])) == (0, 0, 0) and all(
                inside == 0 for _, _, inside in parameters["padding_config"]
            )
        case "rev":
            return axis not in parameters["dimensions"]
        case "transpose" | "squeeze" | "expand_dims":
            return True
        case _:
            return axis not in parameters["axes"]


def is_sum(equation: Equation) -> bool:
    """Whether it sums over rows, as a whole or into the entries of a small table."""
    out = equation.outputs[0]
    if equation.acts or out.kind not in ("float32", "int32") or not 0 < out.size <= SUMMED:
        return False
    if equation.name == "reduce_sum":
        (given,) = equation.inputs
        rows = max(given.shape, default=0)
        axis = row_axis(given.shape, rows)
        return rows >= LEAST and axis in equation.parameters["axes"] and width(given, rows) <= SMALL
    if equation.name != "scatter-add":
        return False
    _, index, update = equation.inputs
    rows = max(update.shape, default=0)
    return (
        rows >= LEAST
        and row_axis(update.shape, rows) == 0 == row_axis(index.shape, rows)
        and width(update, rows) <= SMALL
        and changes_entries(equation)
    )


def changes_entries(equation: Equation) -> bool:
    """Whether a scatter changes whole entries [*k, *d] of a table [V, *d] at indices [*k, 1]."""
    table, index, update = equation.inputs
    numbers = equation.parameters["dimension_numbers"]
    return (
        index.kind in ("int32", "uint32")
        and tuple(numbers.scatter_dims_to_operand_dims) == (0,)
        and tuple(numbers.inserted_window_dims) == (0,)
        and not numbers.operand_batching_dims
        and update.shape == (*index.shape[:-1], *table.shape[1:])
        and tuple(numbers.update_window_dims) == tuple(range(len(index.shape) - 1, len(update.shape)))
    )


def _is_lookup(equation: Equation, rows: int) -> bool:
    """Whether a gather reads whole entries of a table at indices of the row."""
    table, index = equation.inputs
    numbers, sizes = equation.parameters["dimension_numbers"], equation.parameters["slice_sizes"]
    indexed = tuple(numbers.start_index_map)
    rest = [d for d in range(len(table.shape)) if d not in indexed]
    batch, out = len(index.shape) - 1, equation.outputs[0]
    kept = [d for d in range(len(table.shape)) if d not in numbers.collapsed_slice_dims]
    return (
        index.kind in ("int32", "uint32")
        and equation.parameters["mode"] != GatherScatterMode.ONE_HOT
        and table.size < 1 << 31  # places in tables are int32
        and not numbers.operand_batching_dims
        and row_axis(index.shape, rows) is not None
        and width(index, rows) <= SMALL
        and indexed == tuple(range(len(indexed)))
        and all(sizes[d] == 1 for d in indexed)
        and all(sizes[d] == table.shape[d] for d in rest)
        and tuple(numbers.offset_dims) == tuple(range(batch, batch + len(kept)))
        and out.shape[:batch] == index.shape[:-1]
        and row_axis(out.shape, rows) == row_axis(index.shape, rows)
    )


def _is_dot_of_rows(equation: Equation, rows: int) -> bool:
    """Whether products are summed within a row: rows times a small matrix, or a batch of small products."""
    left, right = equation.inputs
    (contracted, _), (batch, other) = equation.parameters["dimension_numbers"]
    a, b, after = (row_axis(v.shape, rows) for v in (left, right, equation.outputs[0]))
    if a is None or a in contracted or left.kind != right.kind or left.kind != "float32":
        return False
    if b is None:
        return right.size <= SMALL and width(left, rows) <= SMALL and not batch and after is not None
    return a in batch and tuple(other)[tuple(batch).index(a)] == b and width(right, rows) <= SMALL
