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
        "A plan leaves out what is wrong by nature. Of the rest it takes what has the least noise in a second. Of what "
        f"it tries, {len(tried)} cells of {len(best)} cases are measured. The worst are those whose derivative is most "
        "too large or too small. Cells that are too noisy to tell are named apart.",
        "",
        f"* Of all that it tries, {_worst(tried)}",
        "* Now the estimator with the least spread in each case; a plan chooses it if it is no slower. Of these "
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
    text = f"the worst is {clear[0]}. {len(beyond)} of {len(clear)} are off by more than {LIMIT:.0%}."
    return text + (f" Too noisy: {', '.join(noisy)}." if noisy else "")
