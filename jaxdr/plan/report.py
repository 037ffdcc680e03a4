"""A plan: an integrator, samples and reasons, as text and as a table that can be read back."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx

from jaxdr.boundary.named import estimator_class, estimator_name
from jaxdr.boundary.shared.term import Term
from jaxdr.html_summary import summary, table
from jaxdr.integrators import BidirectionalPathTracer, Integrator, PathTracer
from jaxdr.integrators.choice import Automatic
from jaxdr.untrusted import damage

INTEGRATORS: dict[str, Any] = {"PathTracer": PathTracer, "BidirectionalPathTracer": BidirectionalPathTracer}


@dataclass(frozen=True)
class Plan:
    """The choice for the derivatives of a scene: `integrator`, `spp` samples per pixel, and the reasons in `lines`.

    `figures` has the measurements. `str(plan)` gives the lines. `to_dict` makes a table for JSON. `Plan.from_dict`
    makes the same plan from it, without measuring again.
    """

    integrator: Any
    spp: int
    lines: tuple[str, ...]
    figures: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def _repr_html_(self) -> str:
        """The choice and its reasons as a table, for notebooks."""
        rows = [("integrator", self.integrator), ("spp", self.spp), *(line.partition(": ")[::2] for line in self.lines)]
        return summary("jaxdr.Plan", table(("", ""), rows))

    def to_dict(self) -> dict[str, Any]:
        """Integrator, samples, lines and figures as a table of numbers, strings, lists and tables.

        Raises ValueError for an integrator or estimator that a table can't hold.
        """
        return {
            "integrator": settings(self.integrator),
            "spp": self.spp,
            "lines": list(self.lines),
            "figures": self.figures,
        }

    @staticmethod
    def from_dict(table: dict[str, Any]) -> "Plan":
        """The plan from which `to_dict` made the table. Raises ValueError for any other table."""
        with damage("not a plan of this version"):
            chosen = integrator(table["integrator"])
            return Plan(chosen, int(table["spp"]), tuple(table["lines"]), dict(table["figures"]))


def settings(integrator: Any) -> dict[str, Any]:
    """The fields of an integrator as a table. Raises ValueError for an integrator that is not this library's."""
    kind = type(integrator).__name__
    if INTEGRATORS.get(kind) is not type(integrator):
        raise ValueError(f"a plan can keep {' and '.join(INTEGRATORS)}, but not {kind}")
    table: dict[str, Any] = {"kind": kind}
    for entry in dataclasses.fields(integrator):
        value = getattr(integrator, entry.name)
        table[entry.name] = _estimator_settings(value) if entry.name == "boundary" else value
    return table


def integrator(table: dict[str, Any]) -> Integrator:
    """The integrator of a table that `settings` made."""
    options = {name: value for name, value in table.items() if name != "kind"}
    options["boundary"] = _value(options["boundary"])
    return INTEGRATORS[table["kind"]](**options)


def _estimator_settings(estimator: Any) -> dict[str, Any] | str | None:
    """The class and the fields of an estimator; those inside a `ByKind` alike."""
    if estimator is None:
        return None
    if isinstance(estimator, Automatic):
        return "auto"
    if not isinstance(estimator, eqx.Module):
        raise ValueError(f"a plan can keep the fields of an equinox.Module, which {type(estimator).__name__} is not")
    return {"kind": estimator_name(type(estimator))} | {
        entry.name: _estimator_settings(value) if isinstance(value, Term) else value
        for entry in dataclasses.fields(estimator)
        for value in [getattr(estimator, entry.name)]
    }


def estimators_in(boundary: Any) -> list[Any]:
    """The names of all estimators in a table's `boundary`: its own, and those of its parts.

    Raises TypeError or KeyError for what is no such table.
    """
    if boundary in (None, "auto"):
        return []
    own = boundary["kind"]
    parts = [value for value in boundary.values() if isinstance(value, dict) and "kind" in value]
    return [own, *(name for part in parts for name in estimators_in(part))]


def _value(value: Any) -> Any:
    """A field of an integrator or estimator, which may be an estimator."""
    if isinstance(value, dict) and "kind" in value:
        return estimator_class(value["kind"])(**{name: _value(v) for name, v in value.items() if name != "kind"})
    return tuple(value) if isinstance(value, list) else value
