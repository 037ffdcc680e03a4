"""Ranges of parameters. A range is declared once, at its field. Constructors and `Scene.replace` check values by it.

The values of traced arrays can't be checked. A model has to take them: for what has no continuation beyond its range,
such as a roughness, it computes with `within`.
"""

import math
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxdr.argument_kinds import made_of_numbers, shown

SHOWN = 4  # values that a message shows; of larger arrays it shows the first that is wrong


class Range(NamedTuple):
    """Values from `low` to `high`, always finite; without the ends themselves if it is `open`.

    `unit` and `remedy` are words for messages.
    """

    low: float
    high: float
    open: bool = False
    unit: str = ""
    remedy: str = ""

    def has(self, values: Float[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
        """Which values lie in the range."""
        inside = (values >= self.low) & (values <= self.high) & np.isfinite(values)
        return np.asarray(inside & (values != self.low) & (values != self.high) if self.open else inside)

    def __str__(self) -> str:
        ends = "in [{:g}, {:g}]" if not self.open else "between {:g} and {:g}"
        if self.high == math.inf:
            ends = "at least {:g}" if not self.open else "a positive number" if self.low == 0 else "above {:g}"
        words = "finite" if self.low == -self.high == -math.inf else ends.format(self.low, self.high)
        return words + (f" {self.unit}" if self.unit else "")


FINITE = Range(-math.inf, math.inf)


def ranged(low: float, high: float, *, open: bool = False, unit: str = "", remedy: str = "") -> dict[str, Range]:
    """Metadata of a field with values from `low` to `high`: `k: Number = eqx.field(metadata=ranged(0.0, 5.0))`."""
    return {"range": Range(low, high, open, unit, remedy)}


def range_of(model: Any, field: str) -> Range:
    """The range that a field of a model, or of its class, declares; all finite numbers if it declares none."""
    return model.__dataclass_fields__[field].metadata.get("range", FINITE)


class Parametric:
    """A model with parameters: its concrete values are in the ranges that its fields declare, and finite.

    A base beside `eqx.Module`. Raises ValueError, with the names of model and field, for other values.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __check_init__(self):
        self.check(self.__dataclass_fields__)

    def check(self, fields: Iterable[str]) -> None:
        """Raises ValueError where a concrete value of these fields is out of range, or does not go with others."""
        for field in fields:
            check_range(getattr(self, field), f"{type(self).__name__}: {field}", range_of(self, field))
        self.check_together()

    def check_together(self) -> None:
        """Raises ValueError where concrete values don't go together. Models with such conditions define it."""


def check_parameter(model: eqx.Module, path: str) -> None:
    """`Parametric.check` for one parameter of a model; names of fields of models inside follow a dot."""
    field, _, rest = path.partition(".")
    if rest:
        check_parameter(getattr(model, field), rest)
    if isinstance(model, Parametric):
        model.check([field])
    elif not rest:
        check_range(getattr(model, field), field, FINITE)


def check_range(value: Any, name: str, within: Range) -> None:
    """Raises ValueError, with the name, for values outside. A value may be a texture; what is no float passes."""
    if hasattr(value, "check_range"):
        if within != FINITE:  # it has checked that itself
            value.check_range(name, within.low, within.high)
        return
    if isinstance(value, Tracer) or not isinstance(value, jax.Array | np.ndarray | np.generic | float):
        return
    values = np.asarray(value)
    if not np.issubdtype(values.dtype, np.floating) or (right := within.has(values)).all():
        return
    if values.size <= SHOWN:
        got = f"{values.tolist()}; {within.remedy}" if within.remedy else values.tolist()
        raise ValueError(f"{name} must be {within}, got {got}")
    first = np.argwhere(~right)[0].tolist()
    wrong = f"{np.sum(~right)} of {values.size} values are not, the first {values[tuple(first)]:g} at {first}"
    raise ValueError(f"{name} must be {within}, and {wrong}")


def at_least(value: Float[Array, "*n"], low: float) -> Float[Array, "*n"]:
    """`within` [low, inf)."""
    return jnp.where(value < low, low, value)


def within(
    value: Float[Array, "*n"], low: float | Float[Array, "*n"], high: float | Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """The nearest value in [low, high]. Unlike with `jnp.clip`, the derivative at the ends is that of inner values."""
    return jnp.where(value < low, low, jnp.where(value > high, high, value))


def floats(value: Any, name: str) -> Any:
    """The value. Raises ValueError, with the name, for an image of whole numbers, as files of 8 bits have them.

    The same for the name of a file, and whatever else is not made of numbers.
    """
    if not made_of_numbers(value):
        raise ValueError(f"{name} must be an array of floats, got {shown(value)}; jd.load_image reads files")
    kind = getattr(value, "dtype", None)
    if kind is not None and not jnp.issubdtype(kind, jnp.floating):
        raise ValueError(f"{name} must be floats, linear, got {kind}; jd.load_image reads files as such")
    return value
