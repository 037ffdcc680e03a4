"""`docs/stability.md`, from the numbers of a run."""

from itertools import groupby
from pathlib import Path

from experiments.common import ROOT
from experiments.stability.choices import choices
from tests.stability.case import COLUMNS, ESTIMATORS, Case, Expected
from tests.stability.catalogue import measured
from tests.stability.elsewhere import ELSEWHERE
from tests.stability.measure import LONG, POSITIONS, SURE, UNRESOLVED

DOCUMENT = ROOT / "docs" / "stability.md"
HEAD = """# Stability

Known failures of differentiable renderers, one scene each, and what every boundary estimator makes of them. Written by

    python -m experiments.stability.run

from `experiments/stability/results`; `tests/stability` asserts the same (`pytest tests/stability`, all cells with
`-m slow`). Settings are the defaults but for `RednerWAS("path_space", sigma0=0.03)` with emitter sampling.

Each case moves one thing by one number t. The reference is the central difference (I(h) - I(-h)) / 2h of images with
common random numbers; estimators are averaged over {positions} positions within the step, so that both are smeared
alike. All numbers are relative to the root mean square of the reference image, its noise taken off; JAX's checks for
NaN and infinity are on.

A cell is **projection ± standard error / bias / spread**: the projection of the mean on the reference is 1 for the
right size; the bias is the root mean square difference of mean and reference, noise taken off (`<` where nothing stands
out of it: then its {sure:g} standard errors); the spread is the standard deviation of one call (16 samples per pixel
unless noted). 32 to 256 calls are made of a cell (`WarpedArea`, `RednerWAS`: 32), until they tell enough; none more
after {long:g} seconds, which leaves larger errors.

* *right*: projection and bias are within the case's tolerance (0.03 and twice that unless noted) and {sure:g} standard
  errors, the spread below the case's bound;
* **biased**: they are not;
* **noisy**: more spread than the bound, or a projection whose standard error is above {unresolved};
* *refuses*: a ValueError says what is missing and what to take (listed below);
* **not finite**: NaN or infinity;
* not measured: the run has not come to it yet, which says nothing about the estimator.
"""


def write_table(cases, folder: Path) -> None:
    """All cases, theme by theme."""
    cases = list(cases)
    cells = {case.name: measured(case, folder) for case in cases}
    lines = [HEAD.format(positions=POSITIONS, sure=SURE, unresolved=UNRESOLVED, long=LONG)]
    lines += ["## Verdicts", "", *_counts(cases, cells)]
    lines += ["", "## Where `jaxdr.plan` chooses", "", *choices(cases, cells)]
    for theme, group in groupby(cases, key=lambda case: case.theme):
        lines += ["", f"## {theme.capitalize()}", "", *_theme(list(group), cells)]
    lines += ["", "## What is wrong, and why", "", *_known(cases, cells)]
    lines += ["", "## What refuses", "", *_refusals(cases, cells)]
    lines += ["", "## Beside derivative images", "", *_elsewhere()]
    DOCUMENT.write_text("\n".join(lines) + "\n")


def _row(*texts) -> str:
    return "| " + " | ".join(str(t) for t in texts) + " |"


def _counts(cases: list[Case], cells: dict) -> list[str]:
    """How many cells of a column have which verdict."""
    names = ("right", "biased", "noisy", "refuses", "not finite", "not measured")
    lines = [_row("estimator", *names), _row(*["---"] * (1 + len(names)))]
    for estimator in ESTIMATORS:
        found = [
            cells[case.name].get(estimator, {"verdict": "not measured"})["verdict"]
            for case in cases
            if estimator in case.estimators()
        ]
        lines.append(_row(estimator if estimator != "none" else "none (interior alone)", *map(found.count, names)))
    return lines


def _theme(cases: list[Case], cells: dict) -> list[str]:
    lines = [_row("case", *COLUMNS), _row(*["---"] * (1 + len(COLUMNS)))]
    for case in cases:
        lines.append(_row(f"`{case.name}`", *(_cell(case, cells[case.name], e) for e in COLUMNS)))
    others = [(case, e) for case in cases for e in case.estimators() if e not in COLUMNS]
    if others:
        lines += ["", _row("case", "estimator", ""), _row("---", "---", "---")]
        lines += [_row(f"`{case.name}`", e, _cell(case, cells[case.name], e)) for case, e in others]
    lines.append("")
    for case in cases:
        notes = [] if case.max_depth == 2 else [f"paths of {case.max_depth} segments"]
        notes += [] if case.spp == 16 else [f"{case.spp} samples per pixel"]
        notes += [] if case.tolerance == 0.03 else [f"tolerance {case.tolerance:g}"]
        more = f" ({', '.join(notes)})" if notes else ""
        lines.append(f"* `{case.name}`: {case.about}{more}. From: {case.source}.")
    return lines


def _cell(case: Case, cells: dict, estimator: str) -> str:
    if estimator not in case.estimators():
        return ""
    found = cells.get(estimator)
    if found is None:
        return "not measured"
    verdict = found["verdict"]
    if verdict in ("refuses", "not finite"):
        return f"*{verdict}*" if verdict == "refuses" else f"**{verdict}**"
    sure = found["bias2"] > SURE * found["bias2_error"]
    limit = max(found["bias2"], 0.0) + SURE * found["bias2_error"]
    bias = f"{found['bias']:.2g}" if sure else f"<{limit**0.5:.2g}"
    numbers = f"{found['projection']:.3f} ± {found['projection_error']:.3f} / {bias} / {found['deviation']:.2g}"
    return numbers if verdict == "right" else f"**{verdict}** {numbers}"


def _known(cases: list[Case], cells: dict) -> list[str]:
    """Every reason once, with the cells that are not right because of it."""
    met: dict[str, list[str]] = {}
    for case in cases:
        for estimator in case.estimators():
            found = cells[case.name].get(estimator)
            if found is None or found["verdict"] in ("right", "refuses"):
                continue
            expected: Expected | None = case.expected.get(estimator)
            why = expected.why if expected and expected.verdict == found["verdict"] else "not explained yet"
            met.setdefault(f"{found['verdict']}: {why}.", []).append(f"`{case.name}` ({estimator})")
    return [f"* {', '.join(names)}: {why}" for why, names in met.items()] or ["Nothing."]


def _refusals(cases: list[Case], cells: dict) -> list[str]:
    """Every message once, with the cases that meet it."""
    met: dict[str, list[str]] = {}
    for case in cases:
        for estimator in case.estimators():
            found = cells[case.name].get(estimator)
            if found is not None and found["verdict"] == "refuses":
                met.setdefault(found["message"], []).append(case.name)
    return [f'* {", ".join(f"`{n}`" for n in dict.fromkeys(names))}: "{text}"' for text, names in met.items()] or [
        "Nothing that was measured."
    ]


def _elsewhere() -> list[str]:
    lines = [_row("case", "what is asserted", "test"), _row("---", "---", "---")]
    return lines + [_row(what, asserted, f"`{test}`") for what, asserted, test in ELSEWHERE]
