"""`docs/borders.md`, from the numbers of a run.

python -m experiments.borders.table
"""

import json

from experiments.common import ROOT
from jaxdr.scene.bsdf.principled import LEAST_COLOR, LEAST_SPECULAR
from tests.borders.measure import BIAS, NEAR, STEPS, SURE
from tests.borders.stages import PROGRAMS

STUDY = "borders"
DOCUMENT = ROOT / "docs" / "borders.md"
RESULTS = ROOT / "experiments" / STUDY / "results"
VERDICTS = ("right", "noisy", "refused", "wrong", "not measured")
HEAD = """# Ends of ranges

Optimisers start from black, clip at zero and overshoot, so parameters are often at the ends of their ranges, or beyond.

- **Concrete values** out of range, NaN and infinity raise a `ValueError`, from constructors and from `Scene.replace`
  alike. The message names the parameter, the range and the value.
- **Traced values** (under `jit`, `grad`, `vmap`) can't be checked. If the image is linear in the parameter
  (reflectances, weights, radiances), image and derivative continue linearly beyond the range, so that an optimiser
  finds its way back.
- Roughness, indices of refraction, exponents, angles of cones and of cameras, and `anisotropic`, `clearcoat_gloss` and
  `specular` of `Principled` have no continuation. Beyond the range they are replaced by the nearest value that can be
  computed, and the derivative is zero. **Clip them after each step of the optimiser**: `jnp.clip(alpha, 1e-4, 1.0)`.
- At the ends themselves derivatives are those of the interior.

The rest of this page is the measurement: every parameter of every public model at both ends of its range, just inside
and just outside (by {near:.0%} of the range). `pytest tests/borders` asserts a part of it, with `-m slow` all of it.

```sh
python -m experiments.borders.run
python -m experiments.borders.table       # writes this page
```

## How it is measured

Every parameter is traced. A weighted sum of pixels is compared with its true slope and limit at the end of the range.
These come from images at values well inside the range: from a line if the image is linear in the parameter, else from a
parabola. A field without a range has an end at 0. In images, one row of texels is at the end.

`Principled` replaces a `specular` below {specular:g}, and a `base_color` of refracted light below {color:g}, by these
values. It takes their square roots, whose exact slopes are infinite at 0. So the truth of these two is taken there.

- *right*: off by less than {bias:.0%} plus {sure:g} standard errors. Outside the range, zero is right too.
- *noisy*: the noise is too large to detect a bias of {bias:.0%}.
- *refused*: a `ValueError` says what is missing.
- **wrong**: anything else, including NaN, and images that jump at the end.

A program is a group of models, a light and an integrator: *default* is `PathTracer(3)`, *emitter* is
`PathTracer(3, sampling="emitter")`, and *bidirectional* is `BidirectionalPathTracer(2)`.

"""


def kept() -> dict[str, dict]:
    """Cells by program."""
    found = {}
    for program in PROGRAMS:
        path = RESULTS / ("_".join(program).replace(" ", "_") + ".json")
        if path.exists():
            found[program.name] = json.loads(path.read_text())["cells"]
    return found


def page() -> str:
    """The text of the page."""
    cells = kept()
    lines = [_head() + "## Verdicts", "", _row("program", *VERDICTS[:-1])]
    lines.append(_row(*["---"] * len(VERDICTS)))
    for program in PROGRAMS:
        found = [cell["verdict"] for cell in cells.get(program.name, {}).values()]
        counts = map(found.count, VERDICTS[:-1]) if found else ["not measured", *[""] * (len(VERDICTS) - 2)]
        lines.append(_row(program.name, *counts))
    for kind, title in (("surfaces", "Materials and textures"), ("lights", "Lights and skies")):
        lines += ["", f"## {title}", "", *_table(kind, cells)]
    wrong = [
        f"* `{name}`, {program}: {cell['why']}"
        + (f", {cell['slope']:.3g} for {cell['expected']:.3g} ± {cell['error']:.2g}" if "slope" in cell else "")
        for program, found in cells.items()
        for name, cell in found.items()
        if cell["verdict"] == "wrong"
    ]
    lines += ["", "## What is wrong", "", *(wrong or ["Nothing that was measured."])]
    every = [cell for found in cells.values() for cell in found.values()]
    refused = sorted({cell["why"] for cell in every if cell["verdict"] == "refused"})
    lines += ["", "## What is refused", "", *([f'* "{why}"' for why in refused] or ["Nothing that was measured."])]
    return "\n".join(lines) + "\n"


def _head() -> str:
    return HEAD.format(near=NEAR, bias=BIAS, sure=SURE, specular=LEAST_SPECULAR, color=LEAST_COLOR)


def _row(*texts) -> str:
    return "| " + " | ".join(map(str, texts)) + " |"


def _table(kind: str, cells: dict) -> list[str]:
    """A row for every border: verdicts outside, at the end and inside, by light and integrator."""
    programs = [program for program in PROGRAMS if program.kind == kind and program.name in cells]
    if not programs:
        return ["Not measured yet."]
    head = [f"{program.light}, {program.integrator}" for program in programs]
    lines = [_row("border", *head), _row(*["---"] * (1 + len(head)))]
    borders = dict.fromkeys(name.rpartition(", ")[0] for p in programs for name in cells[p.name])
    for border in borders:
        lines.append(_row(f"`{border}`", *(_verdicts(border, cells[program.name]) for program in programs)))
    return [f"Each cell: {', '.join(STEPS)}.", "", *lines]


def _verdicts(border: str, found: dict) -> str:
    """The verdict of all three places, once if it is the same."""
    verdicts = [found.get(f"{border}, {place}", {"verdict": ""})["verdict"] for place in STEPS]
    shown = [f"**{v}**" if v == "wrong" else v for v in verdicts]
    return shown[0] if len(set(shown)) == 1 else " / ".join(shown)


if __name__ == "__main__":
    DOCUMENT.write_text(page())
    print(DOCUMENT)
