"""Forward images against Mitsuba 3: the z-score of every pixel, from independent images, on scenes with all features.

    python -m experiments.forward_images.run --scene glass

--store writes the references of tests/references/forward_images, made by Mitsuba, and nothing else.
"""

import csv
import shutil

import numpy as np

from experiments import common
from experiments.forward_images import files, peer
from experiments.forward_images.scenes import CASES, STORED
from experiments.forward_images.statistics import compare

STUDY = "forward_images"
SEEDS = 16
TESTS = common.ROOT / "tests" / "references" / STUDY
COLUMNS = {
    "scene": ("scene", ""),
    "segments": ("max_depth", ""),
    "paths a pixel": ("paths", ","),
    "mean z": ("mean", "+.3f"),
    "sd of z": ("deviation", ".3f"),
    "of t": ("expected_deviation", ".3f"),
    "largest": ("largest", ".1f"),
    "share > 3": ("share", ".2%"),
    "of t ": ("expects", ".2%"),
    "whole image": ("relative", "+.3%"),
    "±": ("relative_error", ".3%"),
    "agrees": ("agrees", ""),
}


def ours(scene, case, seeds):
    """[S, H, W, 3] independent images, of one compiled program."""
    import jax

    import jaxdr as jd

    tracer = jd.PathTracer(max_depth=case.max_depth, boundary=None)
    image = jd.jit(lambda scene, key: jd.render(scene, key, spp=case.spp, integrator=tracer))
    return np.stack([image(scene, key) for key in jax.random.split(jax.random.key(1), seeds)])


def measure(name, folder, seeds, variant):
    """(row of the table, mean image of ours, of Mitsuba's, z)."""
    import jaxdr as jd

    case, path = CASES[name], folder / f"{name}.xml"
    path.write_text(case.xml)
    scene = jd.load_mitsuba(path)
    theirs = peer.images(peer.tessellated(path, scene), case.spp, range(seeds), variant)
    found = ours(scene, case, seeds)
    if not np.isfinite(found).all():
        raise SystemExit(f"{name}: an image is not finite")
    row, z = compare(found, theirs)
    row |= {"scene": name, "max_depth": case.max_depth, "paths": case.spp * seeds, "note": case.note}
    return row, found.mean(0), theirs.mean(0), z


def sheet(pictures, path):
    """Ours, Mitsuba's and z (red: ours is brighter; full at 4), four scenes a row."""
    from jaxdr.images import diverging, labelled_grid, save_png, to_srgb

    cells = []
    for name, (one, two, z) in pictures.items():
        white = max(np.quantile(two, 0.98), 1e-3)
        worst = np.take_along_axis(z, np.abs(z).argmax(-1)[..., None], -1)[..., 0]
        cells.append(
            (name, [to_srgb(np.clip(one / white, 0, 1)), to_srgb(np.clip(two / white, 0, 1)), diverging(worst, 4.0)])
        )
    groups = [cells[i : i + 3] for i in range(0, len(cells), 3)]
    blank = np.full_like(cells[0][1][0], 255)
    grids = []
    for group in groups:
        titles = [title for name, _ in group for title in (name, "Mitsuba", "z")]
        row = [cell for _, three in group for cell in three]
        missing = 9 - len(row)
        grids.append(labelled_grid(titles + [""] * missing, [row + [blank] * missing]))
    save_png(path, np.concatenate(grids))


def store(names, folder, variant):
    """Scenes of 16 x 16 pixels with Mitsuba's mean images and their standard errors, for the default tests."""
    TESTS.mkdir(parents=True, exist_ok=True)
    for name in names:
        case = CASES[name]
        small = case.xml.replace('name="width" value="24"', 'name="width" value="16"')
        small = small.replace('name="height" value="18"', 'name="height" value="16"')
        path = folder / f"{name}_stored.xml"
        path.write_text(small)
        images = peer.images(path, 1024, range(SEEDS), variant)
        error = images.std(0, ddof=1) / np.sqrt(SEEDS)
        np.savez_compressed(
            TESTS / f"{name}.npz",
            mean=images.mean(0).astype(np.float32),
            error=error.astype(np.float32),
            colors=images.mean((1, 2)).astype(np.float32),
            max_depth=case.max_depth,
        )
        (TESTS / f"{name}.xml").write_text(small)
        for file in folder.iterdir():
            if f'value="{file.name}"' in small:
                shutil.copy(file, TESTS / file.name)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--scene", choices=CASES, action="append", help="may be repeated; default: all")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's; scalar_rgb needs no LLVM")
    parser.add_argument("--store", action="store_true", help="write the references of the tests, nothing else")
    options = parser.parse_args()
    scenes = common.scratch(STUDY) / "scenes"
    scenes.mkdir(exist_ok=True)
    files.write_files(scenes)
    if options.store:
        return store(STORED, scenes, options.variant)

    folder = common.results(STUDY, options.quick or bool(options.scene))
    rows, pictures = [], {}
    for name in options.scene or CASES:
        row, *pictures[name] = measure(name, scenes, 4 if options.quick else SEEDS, options.variant)
        print(
            f"{name}: {row['share']:.2%} beyond 3 (t: {row['expects']:.2%}), mean z {row['mean']:+.3f}, "
            f"whole image {row['relative']:+.3%} ± {row['relative_error']:.3%}"
            + ("" if row["agrees"] else "  <-- differs" + (" on purpose" if CASES[name].differs else "")),
            flush=True,
        )
        rows.append(row)
    print("\n" + common.table(rows, COLUMNS))
    (folder / "table.md").write_text(common.table(rows, COLUMNS) + "\n")
    with (folder / "forward_images.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    sheet(pictures, folder / "forward_images.png")


if __name__ == "__main__":
    main()
