"""Functions that all studies share: options, fresh processes, timing, tables, and numbers on disk."""

import argparse
import importlib.metadata
import json
import multiprocessing
import os
import platform
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "experiments/data"


def parser(description):
    """An argument parser with the options that every study takes."""
    made = argparse.ArgumentParser(description=description.split("\n")[0])
    made.add_argument("--quick", action="store_true", help="small sizes: a check that the script runs, not a result")
    made.add_argument("--oracle", type=Path, default=DATA / "reference_scenes", help="folder of the reference scenes")
    return made


def scratch(study):
    """Folder for large intermediate files of a study; not under version control."""
    folder = ROOT / "runs" / study
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def results(study, quick, chosen=None):
    """Folder for the small files that are kept: the `chosen` one, or the study's, which no quick run overwrites."""
    folder = chosen or (scratch(study) / "quick" if quick else ROOT / "experiments" / study / "results")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def in_fresh_process(function, *arguments):
    """`function(*arguments)` in a new interpreter, so that no cache, pool or memory peak is inherited."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def peak_memory():
    """Largest resident memory of this process so far, in bytes."""
    unit = 1 if platform.system() == "Darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def seconds_of(function, *arguments):
    """(result, wall-clock seconds) of one call; waits for JAX arrays in the result."""
    import jax

    start = time.perf_counter()
    answer = jax.block_until_ready(function(*arguments))
    return answer, time.perf_counter() - start


def machine():
    """The processor, its cores and the versions a measurement depends on."""
    versions = {}
    for package in ("jaxdr", "jax", "warp-lang", "mitsuba", "embreex"):
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    model = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.exists():
        names = [line.split(":", 1)[1].strip() for line in information.open() if line.startswith("model name")]
        model = names[0] if names else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"processor": model, "cores": cores, "python": platform.python_version(), **versions}


def write_json(path, numbers):
    """Write `numbers` with the machine that made them."""
    path.write_text(json.dumps({"machine": machine(), **numbers}, indent=1) + "\n")


def table(rows, columns):
    """A Markdown table; `columns` maps a heading to a key of the row and a format, as in {"seconds": ("t", ".2f")}."""
    lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    for row in rows:
        cells = ["" if row.get(key) is None else format(row[key], form) for key, form in columns.values()]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
