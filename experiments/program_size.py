"""The size of a program: equations of its jaxpr, operations of the lowered module, places that call a ray query."""

import re
from collections.abc import Iterator

from jax.extend import core


def equations(jaxpr: core.Jaxpr) -> Iterator[core.JaxprEqn]:
    """All equations of a jaxpr, and of the jaxprs inside it (loops, branches, calls), as often as they occur."""
    for equation in jaxpr.eqns:
        yield equation
        for inside in _jaxprs(tuple(equation.params.values())):
            yield from equations(inside)


def _jaxprs(value) -> Iterator[core.Jaxpr]:
    if isinstance(value, core.ClosedJaxpr):
        yield value.jaxpr
    elif isinstance(value, core.Jaxpr):
        yield value
    elif isinstance(value, tuple | list):
        for member in value:
            yield from _jaxprs(member)
    elif isinstance(value, dict):
        yield from _jaxprs(tuple(value.values()))


def pads_coordinates(equation: core.JaxprEqn) -> bool:
    """Whether an equation pads one coordinate to rows of three: the transpose of the slice `v[..., i]`."""
    if equation.primitive.name != "pad":
        return False
    before, after = equation.invars[0].aval.shape, equation.outvars[0].aval.shape
    return len(before) > 0 and before[-1] == 1 and after[-1] == 3


def operations(text: str) -> int:
    """Operations of a lowered module's `text` (StableHLO): every function's once, however often it is called."""
    return sum(" = " in line for line in text.splitlines())


def call_sites(text: str, query: str) -> int:
    """Places of a lowered module's `text` that call a ray query: "closest_hit" or "occluded"."""
    return len(re.findall(rf"custom_call @\w*{query}\w*\(", text))
