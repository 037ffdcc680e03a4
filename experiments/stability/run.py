"""Bias and spread of every estimator on every case of the stability table.

    python -m experiments.stability.run [--case NAME ...] [--estimator NAME ...] [--quick] [--overwrite]

Cells that were measured before are left alone. It writes `experiments/stability/results/<case>.json`, references beside
the cases, and, once all cells are measured, `docs/stability_cases.md`.
"""

import json
import time
from itertools import groupby

import jax

from experiments import common
from experiments.stability.table import DOCUMENT, write_table
from jaxdr.optimize.progress import Progress
from tests.stability import catalogue as kept
from tests.stability.case import ESTIMATORS, Case
from tests.stability.measure import MOST, measure, reference

STUDY = "stability"


def main(arguments=None):
    parser = common.parser(__doc__)
    parser.add_argument("--case", nargs="+", default=[], help="names of cases (default: all)")
    parser.add_argument("--theme", nargs="+", default=[], help="all cases of these themes")
    parser.add_argument("--estimator", nargs="+", default=[], choices=list(ESTIMATORS), help="default: all of a case")
    parser.add_argument("--overwrite", action="store_true", help="measure again what was measured before")
    options = parser.parse_args(arguments)
    every = kept.catalogue()
    unknown = [name for name in options.case if name not in every]
    if unknown:
        parser.error(f"unknown case {', '.join(unknown)} (known: {', '.join(every)})")
    folder = common.results(STUDY, options.quick)
    everything = not (options.case or options.theme)
    chosen = [c for c in every.values() if everything or c.name in options.case or c.theme in options.theme]

    cells = _missing(chosen, options, folder)
    with Progress("stability", len(cells)) as progress:
        for _, group in groupby(cells, key=lambda cell: (kept.structure(cell[0]), cell[1])):
            jax.clear_caches()
            for case, estimator in group:
                found = _cell(case, estimator, options.quick)
                _save(folder / f"{case.name}.json", estimator, found)
                numbers = {k: found[k] for k in ("projection", "projection_error", "deviation") if k in found}
                progress.say(
                    f"{case.name}, {estimator}: {found['verdict']} "
                    + " ".join(f"{k} {v:.3f}" for k, v in numbers.items())
                    + f" {found.get('message', '')} ({found['seconds']:.0f} s)"
                )
                progress.step()
    if not options.quick:
        write_table(every.values(), folder)
        print(DOCUMENT)


def _missing(chosen, options, folder):
    """Cells without numbers, in an order that uses every compiled program once."""
    cells = []
    for case in chosen:
        done = _load(folder / f"{case.name}.json")
        for estimator in case.estimators():
            if options.estimator and estimator not in options.estimator:
                continue
            same = done.get(estimator, {}).get("fingerprint") == case.fingerprint(estimator)
            if options.overwrite or not same:
                cells.append((case, estimator))
    order = {}
    for case, estimator in cells:
        order.setdefault((kept.structure(case), estimator), len(order))
    return sorted(cells, key=lambda cell: order[kept.structure(cell[0]), cell[1]])


def _cell(case: Case, estimator: str, quick: bool) -> dict:
    against = kept.stored(case)
    if against is None:
        against = reference(case)
        kept.store(case, against)
    start = time.perf_counter()
    found = measure(case, estimator, against, most=1 if quick else MOST)
    return found | {"seconds": time.perf_counter() - start, "fingerprint": case.fingerprint(estimator)}


def _load(path) -> dict:
    return json.loads(path.read_text())["cells"] if path.exists() else {}


def _save(path, estimator, found) -> None:
    cells = _load(path) | {estimator: found}
    common.write_json(path, {"cells": dict(sorted(cells.items()))})


if __name__ == "__main__":
    main()
