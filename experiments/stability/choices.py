"""How wrong the estimators are among which `jaxdr.plan` chooses, from measured cells."""

from typing import NamedTuple

from jaxdr.plan.candidates import candidates
from jaxdr.plan.directions import moving_along
from jaxdr.plan.static_look import static_look
from tests.stability.case import Case

LIMIT = 0.05


class Choice(NamedTuple):
    """A measured cell of an estimator that a plan of its case tries."""

    case: str
    estimator: str
    cell: dict

    @property
    def wrong(self) -> float:
        """The relative error of the size of the derivative."""
        return abs(self.cell["projection"] - 1)

    def __str__(self) -> str:
        size = f"{self.cell['projection']:.3f} ± {self.cell['projection_error']:.3f}"
        return f"`{self.case}` ({self.estimator}, {size})"


def choices(cases: list[Case], cells: dict) -> list[str]:
    """What a plan tries in each case, which of these has the least noise, and how wrong they are."""
    tried, best = [], []
    for case in cases:
        if not case.boundary or case.only:
            continue
        found = [Choice(case.name, name, cells[case.name][name]) for name in _tried(case) if name in cells[case.name]]
        found = [choice for choice in found if choice.cell["status"] == "ok"]
        if found:
            tried += found
            best.append(min(found, key=lambda choice: choice.cell["deviation"]))
    return [
        "A plan leaves out estimators that are known to be biased on a scene. Of the others it takes the one with the "
        f"least noise per second. Of the estimators that plans try, {len(tried)} cells of {len(best)} cases are "
        "measured. The *worst* cell is the one whose derivative has the largest error in size. Cells too noisy to "
        "judge are listed apart.",
        "",
        f"* Of all estimators that a plan tries, {_worst(tried)}",
        "* Of the estimators with the least spread in each case (a plan chooses them unless they are slower), "
        f"{_worst(best)}",
    ]


def _tried(case: Case) -> list[str]:
    look = static_look(case.scene, moving_along(case.scene, tuple(case.moves)))
    return list(dict.fromkeys(type(made).__name__ for made in candidates(look, case.max_depth).tried.values()))


def _worst(found: list[Choice]) -> str:
    clear = sorted((c for c in found if c.cell["verdict"] != "noisy"), key=lambda choice: -choice.wrong)
    if not clear:
        return "none is measured."
    beyond = [choice for choice in clear if choice.wrong > LIMIT]
    noisy = [f"`{c.case}` ({c.estimator})" for c in found if c.cell["verdict"] == "noisy"]
    text = f"the worst is {clear[0]}. {len(beyond)} of {len(clear)} cells are off by more than {LIMIT:.0%}."
    return text + (f" Too noisy: {', '.join(noisy)}." if noisy else "")
