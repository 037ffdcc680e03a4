"""error² · seconds of derivative images of what a mirror shows, against its roughness, by jaxdr and by Mitsuba.

    python -m experiments.roughness.run --scene ball

`ball` is a black ball before a constant sky in a GGX mirror, where only the boundary term is not zero. `mirror_spot` is
the reference scene, with all terms. Errors are measured as in `experiments/equal_time`. Earlier results stay.
"""

import json

from experiments import common
from experiments.equal_time import jaxdr_side, mitsuba_peer, run
from experiments.roughness import scenes

STUDY = "roughness"
ALPHAS = {"ball": (0.02, 0.05, 0.1, 0.3, 0.6), "mirror_spot": (0.05, 0.3)}
LADDERS = (0.05, 0.3)  # roughnesses for which error is charted against time
POSITIONS = 4
LINES, KERNEL = "LineSampling", "KernelDensity"
CHORDS = "LineSampling, 8 chords"  # a path sample
SUM = "AllSilhouettes"
METHODS = {
    "Mitsuba, unguided": (mitsuba_peer.estimates, "none"),
    "Mitsuba, octree": (mitsuba_peer.estimates, "octree"),
    KERNEL: (jaxdr_side.estimates, "KernelDensity"),
    LINES: (jaxdr_side.estimates, "LineSampling"),
    CHORDS: (jaxdr_side.estimates, ("LineSampling", {"chords": 8.0, "backgrounds": 8.0}, {})),
    SUM: (jaxdr_side.estimates, ("AllSilhouettes", {"capacity": 160}, {"chunk_size": 1 << 14})),
}
FEW = {name: 64 if name.startswith("Mitsuba") else 16 for name in METHODS} | {CHORDS: 4, SUM: 4}  # samples per pixel
MANY = {name: (4, 64) for name in METHODS} | {
    "Mitsuba, unguided": (16, 256, 4096),
    "Mitsuba, octree": (16, 1024, 16384),
    LINES: (4, 64, 256),
    CHORDS: (1, 16, 64),
    SUM: (1, 16, 64),
}
LONG = {"Mitsuba, octree": 16384, SUM: 64}  # calls of 20 seconds: half as many offsets must do
COLUMNS = {"scene": ("scene", ""), "roughness": ("alpha", "")} | run.COLUMNS


def written(name, alpha, oracle):
    """(case, path of its scene)."""
    if name == "ball":
        case = scenes.ball(alpha)
        return case, scenes.write_ball(alpha, common.scratch(STUDY) / case.name)
    case = scenes.mirror_spot(alpha)
    return case, scenes.write_mirror_spot(alpha, oracle, common.scratch(STUDY) / case.name)


def measure(name, alpha, methods, options):
    """Rows of one scene and roughness."""
    case, path = written(name, alpha, options.oracle)
    truth = run.reference(path, case, options.quick)
    for method in methods:
        estimates, setting = METHODS[method]
        if name == "mirror_spot" and method == "Mitsuba, octree" and not options.octree:
            continue  # a minute a call
        more = MANY[method] if alpha in LADDERS and name == "ball" and not options.quick else ()
        for spp in sorted({FEW[method], *more}):
            labels = {"scene": name, "alpha": alpha, "method": method}
            positions = POSITIONS // 2 if spp == LONG.get(method) else POSITIONS
            yield run.row_of(case, path, truth, estimates, setting, spp, positions, **labels)


def chart(rows, path):
    """error² · seconds against roughness, a panel a scene; error against seconds at two roughnesses."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels = [name for name in ALPHAS if any(row["scene"] == name for row in rows)]
    ladders = [alpha for alpha in LADDERS if any((row["scene"], row["alpha"]) == ("ball", alpha) for row in rows)]
    figure, axes = plt.subplots(1, len(panels) + len(ladders), figsize=(5 * (len(panels) + len(ladders)), 4.4))
    axes = [axes] if len(panels) + len(ladders) == 1 else list(axes)
    for panel, name in zip(axes, panels, strict=False):
        for i, method in enumerate(METHODS):
            mine = [r for r in rows if (r["scene"], r["method"], r["spp"]) == (name, method, FEW[method])]
            panel.loglog([r["alpha"] for r in mine], [r["work"] for r in mine], "o-", color=f"C{i}", label=method)
        panel.set(title=name, xlabel="roughness α", ylabel="error² · seconds")
        panel.set_xticks(ALPHAS[name], [str(alpha) for alpha in ALPHAS[name]])
        panel.minorticks_off()
    for panel, alpha in zip(axes[len(panels) :], ladders, strict=True):
        for i, method in enumerate(METHODS):
            mine = [r for r in rows if (r["scene"], r["alpha"], r["method"]) == ("ball", alpha, method)]
            mine = sorted((r["seconds"], r["error"]) for r in mine)
            panel.loglog([t for t, _ in mine], [e for _, e in mine], "o-", color=f"C{i}", label=method)
        panel.set(title=f"ball, α = {alpha}", xlabel="seconds a derivative image", ylabel="error / size of it")
    for panel in axes:
        panel.grid(True, which="major", alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=len(METHODS), fontsize=8)
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    figure.savefig(path, dpi=110)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--scene", choices=ALPHAS, action="append", help="may be repeated; default: all")
    parser.add_argument("--method", choices=METHODS, action="append", help="may be repeated; default: all")
    parser.add_argument("--alpha", type=float, action="append", help="may be repeated; default: all")
    parser.add_argument("--octree", action="store_true", help="Mitsuba's octree on mirror_spot too: minutes")
    parser.add_argument("--references", action="store_true", help="make only the references")
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    file = folder / "roughness.json"
    rows = json.loads(file.read_text())["rows"] if file.exists() else []
    for name in options.scene or ALPHAS:
        for alpha in options.alpha or (ALPHAS[name][:1] if options.quick else ALPHAS[name]):
            if options.references:
                case, path = written(name, alpha, options.oracle)
                run.reference(path, case, options.quick)
                continue
            for row in measure(name, alpha, options.method or METHODS, options):
                key = ("scene", "alpha", "method", "spp")
                rows = [old for old in rows if any(old[k] != row[k] for k in key)] + [row]
                common.write_json(file, {"rows": rows})
    if options.references:
        return
    write(rows, folder)


def write(rows, folder):
    """Everything measured so far, sorted: numbers, table and chart."""
    order = list(METHODS)
    rows = sorted(rows, key=lambda r: (r["scene"], r["alpha"], order.index(r["method"]), r["spp"]))
    common.write_json(folder / "roughness.json", {"rows": rows})
    table = common.table(rows, COLUMNS)
    (folder / "table.md").write_text(table + "\n")
    print(table)
    chart(rows, folder / "roughness.png")


if __name__ == "__main__":
    main()
