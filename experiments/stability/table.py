"""`docs/stability_cases.md`, from the numbers of a run."""

from itertools import groupby
from pathlib import Path

from experiments.common import ROOT
from experiments.stability.choices import choices
from tests.stability.case import COLUMNS, ESTIMATORS, Case, Expected
from tests.stability.catalogue import measured
from tests.stability.elsewhere import ELSEWHERE
from tests.stability.measure import IN_DOUBT, LONG, MOST, POSITIONS, SURE, UNRESOLVED

DOCUMENT = ROOT / "docs" / "stability_cases.md"
HEAD = """# Stability, case by case

The measurements behind [stability](stability.md). Each case is a small scene of a kind in which differentiable
renderers are known to fail. The tables show the result of every boundary estimator.

```sh
python -m experiments.stability.run
```

measures what is missing, and writes this page from the numbers in `experiments/stability/results`. The
tests in `tests/stability` assert the same; with `-m slow` they measure all cells. All settings are the defaults, with
one exception: `RednerWAS` is `RednerWAS("path_space", sigma0=0.03)` with emitter sampling.

## How it is measured

Each case moves one thing by one number t. The reference is a central difference, (I(h) - I(-h)) / 2h, of images with
the same random numbers. Estimators are averaged over {positions} positions within the step, so that both are smoothed
alike. All numbers are relative to the root mean square of the reference image, without its noise. JAX's checks for
NaN and infinity are on.

A cell is **projection ± standard error / bias / spread**:

* The *projection* of the mean on the reference is 1 if the size is right.
* The *bias* is the root mean square difference of mean and reference, without noise. If no bias exceeds the
  noise, `<` gives {sure:g} standard errors of it.
* The *spread* is the standard deviation of one call. A call has 16 samples per pixel unless noted.

A cell has {least} to {most} calls, as many as are needed for a verdict. If a bias is still in doubt, it has up to
{doubtful}. After {long:g} seconds no further call is made, so that some errors are larger.

The verdicts:

* *right*: projection and bias are within the case's tolerance plus {sure:g} standard errors, and the spread is below
  the case's bound. The tolerance is 0.03 for the projection and twice as much for the bias, unless noted.
* **biased**: projection or bias is outside.
* **noisy**: the spread is above the bound, or the standard error of the projection is above {unresolved}.
* *refuses*: a `ValueError` says what is missing and what to use instead. The messages are listed below.
* **not finite**: NaN or infinity.
* not measured: not run yet, which does not say anything about the estimator.

*From* names the source of a case: a paper, an issue of another renderer, our own list of suspects (*own list*), or a
failure that we found here (*own finding*).
"""


def write_table(cases, folder: Path) -> None:
    """All cases, theme by theme."""
    cases = list(cases)
    cells = {case.name: measured(case, folder) for case in cases}
    counts = {"least": Case.calls, "most": Case.calls * MOST, "doubtful": Case.calls * MOST * IN_DOUBT}
    lines = [HEAD.format(positions=POSITIONS, sure=SURE, unresolved=UNRESOLVED, long=LONG, **counts)]
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
    """Every reason once, with the estimators and the cells that are not right because of it."""
    met: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for case in cases:
        for estimator in case.estimators():
            found = cells[case.name].get(estimator)
            if found is None or found["verdict"] in ("right", "refuses"):
                continue
            expected: Expected | None = case.expected.get(estimator)
            why = expected.why if expected and expected.verdict == found["verdict"] else "not explained yet"
            met.setdefault((found["verdict"], why), []).append((case.name, estimator))
    lines = []
    for (verdict, why), pairs in met.items():
        estimators = list(dict.fromkeys(estimator for _, estimator in pairs))
        which = [f"`{name}`" + (f" ({estimator})" if len(estimators) > 1 else "") for name, estimator in pairs]
        lines.append(f"* {'; '.join(estimators)}, **{verdict}**: {why}. Cells: {', '.join(which)}.")
    return lines or ["Nothing."]


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
