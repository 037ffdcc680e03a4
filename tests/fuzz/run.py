"""Damages inputs of all kinds at random, and reports what readers do not answer with a result or one clear error.

    python -m tests.fuzz.run --count 50000

Every kind is read in a process of its own with a limit of memory, which is started again after a hang or a crash.
Faulty inputs are kept in `--keep`. The exit status is 1 if there are any.
"""

import argparse
import json
import resource
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.fuzz.examine import SECONDS, damage_input, examine, example
from tests.fuzz.kinds import KINDS

ADDRESSES = 12 << 30  # bytes of virtual memory that a process may add: far above what honest files take


def main() -> int:
    """Run, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=50_000, help="inputs of all kinds together")
    parser.add_argument("--kind", action="append", choices=[*KINDS], help="only this one; repeatable")
    parser.add_argument("--seed", type=int, default=0, help="of the first input")
    parser.add_argument("--keep", type=Path, default=Path("runs/fuzz"), help="folder for faulty inputs")
    parser.add_argument("--worker", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        name, folder, first, count = options.worker
        return work(name, Path(folder), int(first), int(count))
    names, faults = options.kind or [*KINDS], 0
    print(f"{'kind':<16}{'inputs':>8}{'read':>8}{'refused':>9}{'faults':>8}{'seconds':>9}{'most s':>8}{'most MB':>9}")
    for name in names:
        faults += report(name, options.seed, -(-options.count // len(names)), options.keep)
    return 1 if faults else 0


def report(name: str, first: int, count: int, keep: Path) -> int:
    """Examine so many inputs of a kind, print a line, and return the number of faults."""
    start, totals, slowest, largest = time.perf_counter(), Counter(), 0.0, 0.0
    with tempfile.TemporaryDirectory() as place:
        example(KINDS[name], Path(place) / "valid")
        following, end = first, first + count
        while following < end:
            for seed, fault, refused, seconds, megabytes in answers(name, Path(place), following, end - following):
                following = seed + 1
                totals["faults" if fault else "refused" if refused else "read"] += 1
                slowest, largest = max(slowest, seconds), max(largest, megabytes)
                if fault:
                    kept = keep / f"{name}_{seed}"
                    damage_input(KINDS[name], Path(place) / "valid", kept, seed)
                    print(f"{kept}: {' '.join(fault.split())[-400:]}", file=sys.stderr, flush=True)
    took = time.perf_counter() - start
    print(
        f"{name:<16}{count:>8}{totals['read']:>8}{totals['refused']:>9}{totals['faults']:>8}{took:>9.0f}"
        f"{slowest:>8.1f}{largest:>9.0f}",
        flush=True,
    )
    return totals["faults"]


def answers(name: str, place: Path, first: int, count: int):
    """(seed, fault, refused, seconds, megabytes) of inputs from the seed `first` on, until a process ends or hangs."""
    command = [sys.executable, "-m", "tests.fuzz.run", "--worker", name, str(place), str(first), str(count)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        seed, patience = first, 60.0  # the first answer waits for imports
        while seed < first + count:
            if not select.select([process.stdout], [], [], patience)[0]:
                process.kill()
                yield seed, f"no answer in {patience:.0f} s", False, patience, 0.0
                return
            line = process.stdout.readline()
            if not line:
                process.wait()
                yield seed, f"the process ended with status {process.returncode}", False, 0.0, 0.0
                return
            yield seed, *json.loads(line)
            seed, patience = seed + 1, 2 * SECONDS


def work(name: str, place: Path, first: int, count: int) -> int:
    """What a process of `report` does: a line of JSON for each input."""
    kind = KINDS[name]
    kind.read(place / "valid")  # what is imported and compiled once is not the input's
    here = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (here + ADDRESSES, resource.RLIM_INFINITY))
    answer = sys.stdout
    sys.stdout = sys.stderr  # a reader prints nothing; if it does, it is no answer
    for seed in range(first, first + count):
        print(json.dumps(examine(kind, place / "valid", place / "input", seed)), file=answer, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
