"""Derivatives and images at the ends of all ranges, against what inner values say.

    python -m experiments.borders.run [--program WORDS ...] [--keys N] [--overwrite]

Programs that were measured before are left alone. It writes `experiments/borders/results/<program>.json`.
`python -m experiments.borders.table` makes `docs/borders.md` of them.
"""

import json
import time

import jax

from experiments import common
from experiments.borders.table import STUDY
from jaxdr.optimize.progress import Progress
from tests.borders.measure import measured
from tests.borders.stages import PROGRAMS, Program

SPP = 64


def main(arguments=None):
    parser = common.parser(__doc__)
    parser.add_argument("--program", nargs="+", default=[], help="words that the names of programs have (default: all)")
    parser.add_argument("--keys", type=int, default=64, help="repetitions of every cell")
    parser.add_argument("--overwrite", action="store_true", help="measure again what was measured before")
    options = parser.parse_args(arguments)
    folder = common.results(STUDY, options.quick)
    chosen = [p for p in PROGRAMS if all(word in p.name for word in options.program)]
    left = [p for p in chosen if options.overwrite or not (folder / file_of(p)).exists()]
    with Progress("borders", len(left)) as progress:
        for program in left:
            jax.clear_caches()
            start = time.perf_counter()
            found = measured(program, 4 if options.quick else options.keys, 4 if options.quick else SPP)
            common.write_json(folder / file_of(program), {"program": program.name, "cells": found})
            verdicts = [cell["verdict"] for cell in found.values()]
            counts = ", ".join(f"{verdicts.count(v)} {v}" for v in sorted(set(verdicts)))
            progress.say(f"{program.name}: {counts} ({time.perf_counter() - start:.0f} s)")
            progress.step()


def file_of(program: Program) -> str:
    """Name of the file with the cells of a program."""
    return "_".join(program).replace(" ", "_") + ".json"


def load(path) -> dict:
    """Cells of a program by name."""
    return json.loads(path.read_text())["cells"]


if __name__ == "__main__":
    main()
