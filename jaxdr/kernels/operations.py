"""What each row-wise operation of JAX is in C++: a list of expressions, one for each component of the result.

Vectors are `F` (float32), `I` (int32), `U` (uint32) and `B` (bool, lanes 0 or -1); `vector.h` has the functions.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxdr.kernels.flatten import Equation, Value
from jaxdr.kernels.rows import STRUCTURAL, components, row_axis

VECTORS = {"float32": "F", "int32": "I", "uint32": "U", "bool": "B"}
SCALARS = {"float32": "float", "int32": "int", "uint32": "unsigned", "bool": "unsigned char"}
FUNCTIONS = frozenset(
    "exp exp2 log log1p expm1 sin cos tan tanh asin acos atan logistic erf cbrt sign".split()
)  # `v_NAME` in vector.h; of floats
COMPARISONS = {"lt": "<", "gt": ">", "le": "<=", "ge": ">=", "eq": "==", "ne": "!="}
IN_TOTAL_ORDER = {"lt_to": "<", "le_to": "<="}  # of `searchsorted`
ARITHMETIC = {"add": "+", "add_any": "+", "sub": "-", "mul": "*"}
BITS = {"and": "&", "or": "|", "xor": "^"}
OF_BOOLS = {"add": "or", "add_any": "or", "mul": "and", "max": "or", "min": "and", "sub": "xor"}
Components = list[str]


def literal(number: Any, kind: str) -> str:
    """A number as a vector of equal lanes."""
    if kind == "bool":
        return "B(-1)" if number else "B(0)"
    if kind != "float32":
        return f"{VECTORS[kind]}({int(number)}{'u' if kind == 'uint32' else ''})" if number > -(2**31) else "I(1<<31)"
    if np.isnan(number):
        return 'F(__builtin_nanf(""))'
    if np.isinf(number):
        return f"F({'-' if number < 0 else ''}__builtin_inff())"
    return f"F({float(number).hex()}f)"


def indices(value: Value, rows: int) -> np.ndarray:
    """The numbers of an array's components, in the shape of `components`."""
    shape = components(value, rows)
    return np.arange(math.prod(shape)).reshape(shape)


def has_rule(equation: Equation) -> bool:
    """Whether `computed` knows an operation on these kinds of numbers."""
    name = equation.name
    return name in STRUCTURAL or name in REDUCTION_FORMS or name == "dot_general" or _rule(equation) is not None


def computed(equation: Equation, rows: int, given: Sequence[Components]) -> list[Components]:
    """Expressions for the components of every output, of an operation that has a rule."""
    name, out = equation.name, equation.outputs[0]
    if name in STRUCTURAL:
        return rearranged(equation, rows, given)
    if name in REDUCTION_FORMS:
        return [_reduced(equation, rows, given[0])]
    if name == "dot_general":
        return [_products(equation, rows, *given)]
    rule = _rule(equation)
    assert rule is not None
    shape = components(out, rows)
    spread = [
        [part[i] for i in np.broadcast_to(indices(v, rows), shape).ravel()]
        for v, part in zip(equation.inputs, given, strict=True)
    ]
    return [[rule(*numbers) for numbers in zip(*spread, strict=True)]]


def _rule(equation: Equation) -> Callable[..., str] | None:
    """An elementwise operation as a function of expressions."""
    name, parameters = equation.name, equation.parameters
    kind, after = equation.inputs[0].kind, equation.outputs[0].kind
    if kind == "bool" and name in OF_BOOLS:
        name = OF_BOOLS[name]
    vector = VECTORS[after]
    if name in COMPARISONS:
        if kind == "bool":  # true is -1 here
            return lambda a, b: f"B(I({b}) {COMPARISONS[name]} I({a}))"
        return lambda a, b: f"B({a} {COMPARISONS[name]} {b})"
    if name in IN_TOTAL_ORDER:
        return lambda a, b: f"B(v_order({a}) {IN_TOTAL_ORDER[name]} v_order({b}))"
    if name in ARITHMETIC or name in BITS:
        return lambda a, b: f"{a} {(ARITHMETIC | BITS)[name]} {b}"
    if name in FUNCTIONS:
        return (lambda a: f"v_{name}({a})") if kind == "float32" or name == "sign" else None
    match name:
        case "div":
            return lambda a, b: f"{a} / {b}" if kind == "float32" else f"v_div({a}, {b})"
        case "rem":
            return lambda a, b: f"v_rem({a}, {b})"
        case "max" | "min" | "pow" | "atan2" if name in ("max", "min") or equation.inputs[1].kind == "float32":
            return lambda a, b: f"v_{name}({a}, {b})"
        case "shift_left" | "shift_right_logical" | "shift_right_arithmetic":
            return lambda a, b: f"v_{name}({a}, {b})"
        case "neg":
            return lambda a: f"-{a}"
        case "not":
            return lambda a: f"~{a}"
        case "abs" | "sqrt" | "floor" | "ceil":
            return (lambda a: a) if kind == "uint32" else (lambda a: f"ELEMENTWISE({name})({a})")
        case "round":
            way = "roundeven" if parameters["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN else "round"
            return lambda a: f"ELEMENTWISE({way})({a})"
        case "rsqrt":
            return lambda a: f"F(1.0f) / ELEMENTWISE(sqrt)({a})"
        case "square":
            return lambda a: f"{a} * {a}"
        case "integer_pow":
            return lambda a: _power(a, parameters["y"], vector)
        case "is_finite":
            return lambda a: f"B(ELEMENTWISE(abs)({a}) < F(__builtin_inff()))"
        case "clamp" if kind != "bool":
            return lambda low, a, high: f"v_min(v_max({a}, {low}), {high})"
        case "select_n" if len(equation.inputs) == 3 and kind == "bool":
            return lambda which, a, b: f"v_select({which}, {b}, {a})"
        case "convert_element_type":
            if kind == "bool" != after:
                return lambda a: f"of_bool_{vector}({a})"
            return lambda a: a if kind == after else f"to_{vector}({a})"
        case "bitcast_convert_type" if "bool" not in (kind, after):
            return lambda a: f"({vector}){a}"
        case "copy" | "copy_p":
            return lambda a: a
    return None


def _power(a: str, exponent: int, vector: str) -> str:
    """A product by squaring, as XLA does."""
    product, square, left = "", a, abs(exponent)
    while left:
        if left & 1:
            product = f"{product} * {square}" if product else square
        left >>= 1
        if left:
            square = f"({square} * {square})"
    product = product or f"{vector}(1)"
    return product if exponent >= 0 else f"F(1.0f) / ({product})"


def rearranged(equation: Equation, rows: int, given: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """The components of every output of an operation that only places components, without a look at them."""
    numbers, every = _placed(equation, rows, given)
    return [[every[i] if i >= 0 else given[1][0] for i in n.ravel()] for n in numbers]


def _placed(equation: Equation, rows: int, given: Sequence[Sequence[Any]]) -> tuple[list[np.ndarray], list[Any]]:
    """For each output the numbers of the components that it consists of, -1 for padding; and all components."""
    parameters, out = equation.parameters, equation.outputs[0]
    every = [c for part in given for c in part]
    starts = np.cumsum([0, *map(len, given)])
    number, *others = (indices(v, rows) + start for v, start in zip(equation.inputs, starts, strict=False))
    shape = components(out, rows)
    match equation.name:
        case "broadcast_in_dim":
            wide = [1] * len(shape)
            for dimension, length in zip(parameters["broadcast_dimensions"], number.shape, strict=True):
                wide[dimension] = length
            return [np.broadcast_to(number.reshape(wide), shape)], every
        case "unstack":
            axis = parameters["axis"]
            return [np.asarray(np.take(number, i, axis)) for i in range(len(equation.outputs))], every
        case "stack":
            return [np.stack([number, *others], parameters["axis"])], every
        case "concatenate":
            return [np.concatenate([number, *others], parameters["dimension"])], every
        case "split":
            return np.split(number, np.cumsum(parameters["sizes"])[:-1], parameters["axis"]), every
        case "slice":
            axis = row_axis(equation.inputs[0].shape, rows)
            strides = parameters["strides"] or (1,) * len(shape)
            bounds = zip(parameters["start_indices"], parameters["limit_indices"], strides, strict=True)
            return [number[tuple(slice(None) if d == axis else slice(*b) for d, b in enumerate(bounds))]], every
        case "pad":
            # Negative widths cut off.
            wide = np.pad(
                number, [(max(0, a), max(0, b)) for a, b, _ in parameters["padding_config"]], constant_values=-1
            )
            cut = [
                slice(max(0, -a), length - max(0, -b))
                for (a, b, _), length in zip(parameters["padding_config"], wide.shape, strict=True)
            ]
            return [wide[tuple(cut)]], every
        case "transpose":
            return [number.transpose(parameters["permutation"])], every
        case "rev":
            return [np.flip(number, parameters["dimensions"])], every
        case _:
            return [number.reshape(shape)], every


REDUCTION_FORMS = {
    "reduce_sum": "{} + {}",
    "reduce_prod": "{} * {}",
    "reduce_max": "v_max({}, {})",
    "reduce_min": "v_min({}, {})",
    "reduce_or": "{} | {}",
    "reduce_and": "{} & {}",
}


def _reduced(equation: Equation, rows: int, given: Components) -> Components:
    axes = tuple(equation.parameters["axes"])
    numbers = np.moveaxis(indices(equation.inputs[0], rows), axes, range(-len(axes), 0))
    form = REDUCTION_FORMS[equation.name]
    if equation.inputs[0].kind == "bool":
        form = {"reduce_max": "{} | {}", "reduce_min": "{} & {}"}.get(equation.name, form)
    count = math.prod(components(equation.outputs[0], rows))
    found = []
    for numbers_of_one in numbers.reshape(count, -1):
        total = given[numbers_of_one[0]]
        for i in numbers_of_one[1:]:
            total = f"({form.format(total, given[i])})"
        found.append(total)
    return found


def _products(equation: Equation, rows: int, left: Components, right: Components) -> Components:
    """Sums of products, by the numbers of their components."""
    (a_sum, b_sum), (a_batch, b_batch) = equation.parameters["dimension_numbers"]
    a, b = (indices(v, rows) for v in equation.inputs)
    a_free = [d for d in range(a.ndim) if d not in (*a_sum, *a_batch)]
    b_free = [d for d in range(b.ndim) if d not in (*b_sum, *b_batch)]
    batch = [a.shape[d] for d in a_batch]
    terms = math.prod([a.shape[d] for d in a_sum])
    a = a.transpose(*a_batch, *a_free, *a_sum).reshape(*batch, -1, 1, terms)
    b = b.transpose(*b_batch, *b_free, *b_sum).reshape(*batch, 1, -1, terms)
    a, b = np.broadcast_arrays(a, b)
    return [
        " + ".join(f"{left[i]} * {right[j]}" for i, j in zip(x, y, strict=True)) or "F(0.0f)"
        for x, y in zip(a.reshape(-1, terms), b.reshape(-1, terms), strict=True)
    ]
