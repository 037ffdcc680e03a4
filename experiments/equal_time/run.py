"""Error against time of derivative images: jaxdr and Mitsuba's projective integrators on the same scenes.

    python -m experiments.equal_time.run --case shadow_goathead

Results of earlier runs stay: a chart shows every case that has a file in results/.
"""

import json
import statistics as quantiles

import numpy as np

from experiments import common
from experiments.equal_time import errors, jaxdr_side, mitsuba_peer
from experiments.equal_time.cases import CASES, write_scene

STUDY = "equal_time"
SEEDS = 2  # calls at every offset: what they differ by is noise
LONG = 1024  # samples per pixel from which calls take so long that half as many offsets must do
BUDGET = (0.1, 1.0)  # seconds of an optimisation step

METHODS = {
    "Mitsuba, unguided": (mitsuba_peer.estimates, "none", (16, 64, 256, 1024, 4096), 8),
    "Mitsuba, octree": (mitsuba_peer.estimates, "octree", (16, 64, 256, 1024, 4096), 4),
    "jaxdr, KernelDensity": (jaxdr_side.estimates, "KernelDensity", (4, 16, 64, 256), 8),
    "jaxdr, LineSampling": (jaxdr_side.estimates, "LineSampling", (1, 4, 16, 64, 256, 1024), 8),
}
COLUMNS = {
    "method": ("method", ""),
    "spp": ("spp", ""),
    "seconds": ("seconds", ".3f"),
    "error": ("error", ".3f"),
    "standard deviation": ("deviation", ".3f"),
    "bias": ("bias", ".3f"),
    "projection": ("projection", ".3f"),
    "error² · seconds": ("work", ".2e"),
    "first call, seconds": ("first_call", ".1f"),
}


def reference(path, case, quick):
    """The finite-difference reference; made once and kept under runs/."""
    batches = 4 if quick else case.batches
    kept = common.scratch(STUDY) / f"reference_{case.name}_{case.step}_{batches}.npz"
    if not kept.exists():
        np.savez(kept, **common.in_fresh_process(mitsuba_peer.reference, path, case, batches))
    return dict(np.load(kept))


def row_of(case, path, truth, estimates, setting, spp, positions, **labels):
    """A row of a table: `labels` (`method` is one), errors and times of `SEEDS` calls at so many offsets each.

    The calls are made in a fresh process.
    """
    offsets = [case.step * ((2 * k + 1) / positions - 1) for k in range(positions)]
    images, seconds, first = common.in_fresh_process(estimates, path, case, setting, spp, offsets, SEEDS)
    row = errors.statistics(images, truth["image"], truth["noise_variance"]) | labels
    row |= {"spp": spp, "seconds": quantiles.median(seconds), "all_seconds": seconds, "first_call": first}
    row["work"] = row["error"] ** 2 * row["seconds"]
    print(f"  {case.name}, {row['method']}, {spp} spp: error {row['error']:.3f} in {row['seconds']:.3f} s", flush=True)
    return row


def measure(case, method, oracle, quick, samples=None):
    """The rows of one method on one case."""
    path = write_scene(case, oracle, common.scratch(STUDY) / case.name)
    truth = reference(path, case, quick)
    estimates, setting, counts, positions = METHODS[method]
    if quick:
        counts, positions = counts[:2], 2
    for spp in [n for n in counts if not samples or n in samples]:
        count = positions // 2 if spp >= LONG else positions
        yield row_of(case, path, truth, estimates, setting, spp, count, method=method)


def verdict(rows):
    """Every method's best figure of merit, within the budget and at any time, and Mitsuba's better over ours."""
    lines = []
    for what, (least, most) in {"within 0.1-1 s": BUDGET, "at any time": (0.0, float("inf"))}.items():
        for merit, quantity in {"error² · seconds": "error", "variance · seconds": "deviation"}.items():
            best = {}
            for row in rows:
                if least <= row["seconds"] <= most:
                    work = row[quantity] ** 2 * row["seconds"]
                    best[row["method"]] = min(work, best.get(row["method"], float("inf")))
            found = ", ".join(f"{method} {work:.2e}" for method, work in best.items())
            ours = [work for method, work in best.items() if method.startswith("jaxdr")]
            theirs = [work for method, work in best.items() if method.startswith("Mitsuba")]
            ratio = f"; ratio {min(theirs) / min(ours):.1f}" if ours and theirs else ""
            lines.append(f"- least {merit} {what}: {found or 'none'}{ratio}")
    return lines


def chart(per_case, path):
    """One log-log panel a case: error against seconds; dotted, the bias where it is known."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(per_case), figsize=(5.2 * len(per_case), 4.4), squeeze=False)
    for panel, (name, rows) in zip(panels[0], per_case.items(), strict=True):
        for i, method in enumerate(METHODS):
            mine = sorted((row["seconds"], row["error"], row["spp"]) for row in rows if row["method"] == method)
            if not mine:
                continue
            seconds, error, spp = zip(*mine, strict=True)
            panel.loglog(seconds, error, "o-", color=f"C{i}", label=method)
            for x, y, n in zip(seconds, error, spp, strict=True):
                panel.annotate(str(n), (x, y), textcoords="offset points", xytext=(4, 4), fontsize=7)
            last = max((row for row in rows if row["method"] == method), key=lambda row: row["spp"])
            if last["bias"] > last["bias_resolution"]:
                panel.axhline(last["bias"], color=f"C{i}", linestyle=":", linewidth=1)
        panel.axvspan(*BUDGET, color="0.93", zorder=0)
        panel.set(title=name, xlabel="seconds a derivative image", ylabel="error / size of the derivative")
        panel.grid(True, which="major", alpha=0.3)
    panels[0, 0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--case", choices=CASES, action="append", help="may be repeated; default: all")
    parser.add_argument("--method", choices=METHODS, action="append", help="may be repeated; default: all")
    parser.add_argument("--spp", type=int, action="append", help="sample count, may be repeated; default: all")
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)

    for case in (CASES[name] for name in options.case or CASES):
        file = folder / f"{case.name}.json"
        old = json.loads(file.read_text())["rows"] if file.exists() else []
        for method in options.method or METHODS:
            rows = list(measure(case, method, options.oracle, options.quick, options.spp))
            fresh = {row["spp"] for row in rows}
            kept = [row for row in old if row["method"] != method or row["spp"] not in fresh]
            old = sorted(kept + rows, key=lambda row: (list(METHODS).index(row["method"]), row["spp"]))
            common.write_json(file, {"case": case.name, "rows": old})

    per_case = {name: folder / f"{name}.json" for name in CASES if (folder / f"{name}.json").exists()}
    per_case = {name: json.loads(file.read_text())["rows"] for name, file in per_case.items()}
    report = []
    for name, rows in per_case.items():
        report += [f"### {name}", "", common.table(rows, COLUMNS), "", *verdict(rows), ""]
    print("\n" + "\n".join(report))
    (folder / "table.md").write_text("\n".join(report))
    chart(per_case, folder / "equal_time.png")


if __name__ == "__main__":
    main()
