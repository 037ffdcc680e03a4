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

Optimisers start from black, clip at zero and overshoot. So parameters live at the ends of their ranges.

- **Concrete values** out of range, NaN and infinity raise a `ValueError`, from constructors and from `Scene.replace`
  alike. It names the parameter, the range and the value.
- **Traced values** (under `jit`, `grad`, `vmap`) can't be checked. Where the image is linear in the parameter
  (reflectances, weights, radiances), it goes on linearly beyond the range, and so does the derivative: an optimiser
  finds its way back.
- Roughness, indices of refraction, exponents, angles of cones and of cameras, `anisotropic`, `clearcoat_gloss` and
  `specular` of `Principled` have no continuation. Beyond the range they count as the nearest value that can be
  computed, and the derivative is zero. **Clip after each step of the optimiser**: `jnp.clip(alpha, 1e-4, 1.0)`.
- At the ends themselves derivatives are those of inner values.

```sh
python -m experiments.borders.run
python -m experiments.borders.table
```

measures every parameter of every public model at both ends of its range, just inside and just outside (by {near:.0%}
of the range), and writes this page. `pytest tests/borders` asserts a part of it, with `-m slow` all.

## How it is measured

Every parameter is traced. The truth is the slope, and the limit, of images at values well inside of the range: of a
line where the image is linear, of a parabola elsewhere. What is compared is a weighted sum of pixels. A field without
a range has a border at 0. Images have the border in one row of texels.

`Principled` counts a `specular` below {specular:g}, and a `base_color` of refracted light below {color:g}, as these. It
takes their roots, whose exact slopes are infinite at 0. So the truth of these two is taken there.

- *right*: off by less than {bias:.0%}, and {sure:g} standard errors. Outside, zero is right too.
- *noisy*: a bias of {bias:.0%} can't be told.
- *refused*: a `ValueError` says what is missing.
- **wrong**: anything else, also NaN, and images that jump at the end.

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
