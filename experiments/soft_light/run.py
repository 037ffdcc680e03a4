"""error² · seconds of derivative images against the size of the light.

    python -m experiments.soft_light.run

The scene is `shadow_goathead` with its light scaled by 1/8 to 8; errors are measured as in `experiments/equal_time`.
"""

import dataclasses
import json

from experiments import common
from experiments.equal_time import run
from experiments.equal_time.cases import CASES, write_scene

STUDY = "soft_light"
SIZES = (1 / 8, 1 / 3, 1.0, 3.0, 8.0)
SAMPLES = {
    "Mitsuba, unguided": (256,),
    "Mitsuba, octree": (256,),
    "jaxdr, KernelDensity": (64,),
    "jaxdr, LineSampling": (64,),
}
COLUMNS = {"light": ("light", ".3g")} | run.COLUMNS
BATCHES = 64
POSITIONS = 4


def measure(size, oracle, quick):
    """Rows of all methods for one size of the light."""
    case = dataclasses.replace(CASES["shadow_goathead"], name=f"light_{size:.3f}", batches=BATCHES, light_scale=size)
    path = write_scene(case, oracle, common.scratch(STUDY) / case.name)
    truth = run.reference(path, case, quick)
    for method, counts in SAMPLES.items():
        estimates, setting, _, _ = run.METHODS[method]
        for spp in counts:
            yield run.row_of(case, path, truth, estimates, setting, spp, POSITIONS, light=size, method=method)


def chart(rows, path):
    """error² · seconds against the size of the light, one line a method: the better of its sample counts."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots(figsize=(6.4, 4.4))
    for i, method in enumerate(SAMPLES):
        mine = [row for row in rows if row["method"] == method]
        sizes = sorted({row["light"] for row in mine})
        best = [min(row["work"] for row in mine if row["light"] == size) for size in sizes]
        panel.loglog(sizes, best, "o-", color=f"C{i}", label=method)
    panel.set_xticks(sizes, [f"{size:.3g}" for size in sizes])
    panel.minorticks_off()
    panel.set(xlabel="size of the light", ylabel="error² · seconds", title="soft shadow of goathead")
    panel.grid(True, which="major", alpha=0.3)
    panel.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    options = common.parser(__doc__).parse_args()
    folder = common.results(STUDY, options.quick)
    sizes = SIZES[1:3] if options.quick else SIZES
    rows = []
    for size in sizes:
        rows += measure(size, options.oracle, options.quick)
        common.write_json(folder / "soft_light.json", {"rows": rows})
    rows = json.loads((folder / "soft_light.json").read_text())["rows"]
    table = common.table(rows, COLUMNS)
    (folder / "table.md").write_text(table + "\n")
    print(table)
    chart(rows, folder / "soft_light.png")


if __name__ == "__main__":
    main()
