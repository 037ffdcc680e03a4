"""What a user sees when a run is killed, told to end, or loses its disk; and whether it goes on with the same bits.

    python -m experiments.faults.run [--kind optimize] [CASE ...]

Every case is a real run in a process of its own. A full disk is a small file system in memory. Only root may mount
one; without root that case is left out, and the report says so.
"""

import argparse
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

from experiments.faults.runs import Reconstruction, Run

MOMENTS = 10  # of each signal
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


def killed(run: Run) -> None:
    """kill -9 in the middle of a step."""
    process = run.start()
    run.wait_for_step(process, 11)
    process.kill()
    run.ended(process)
    run.ended(run.start("--resume"))


def terminated(run: Run) -> None:
    """SIGTERM, as schedulers send it."""
    process = run.start()
    run.wait_for_step(process, 11)
    process.send_signal(signal.SIGTERM)
    run.ended(process)
    run.ended(run.start("--resume"))


def full_disk(run: Run) -> None:
    """Something else fills the disk; later there is room again."""
    with small_disk(run.place):
        process = run.start()
        run.wait_for_step(process, 9)
        ballast = run.place / "ballast"
        with open(ballast, "wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError:
                pass
        run.ended(process)
        ballast.unlink()
        run.ended(run.start("--resume"))
        run.found = run.result()


def removed(run: Run) -> None:
    """The folder of the run is deleted while it goes on: nothing is left to go on from."""
    process = run.start()
    run.wait_for_step(process, 9)
    shutil.rmtree(run.output, ignore_errors=True)
    shutil.rmtree(run.output, ignore_errors=True)
    code, lines = run.ended(process)
    assert code == 2 and "is gone" in lines[-1]
    run.found = {}


def two_at_once(run: Run) -> None:
    """Two more runs are started in the folder of a run that goes on: they are refused, and it ends as if alone."""
    process, said = run.start(), run.said
    run.wait_for_step(process, 5)
    process.send_signal(signal.SIGSTOP)  # until the others have started, which takes longer than all of its steps
    for option in ("--overwrite", "--resume"):
        code, lines = run.ended(run.start(option))
        assert code == 2 and "another run is at work there" in lines[-1]
    process.send_signal(signal.SIGCONT)
    run.said = said
    run.ended(process)


def input_changed(run: Run) -> None:
    """A file that the run reads is changed before it goes on: it is refused until the old file is back."""
    process = run.start()
    run.wait_for_step(process, 5)
    process.kill()
    run.end(process)
    content = run.input.read_bytes()
    run.input.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    code, lines = run.ended(run.start("--resume"))
    run.input.write_bytes(content)
    assert code == 2 and "has other contents" in lines[-1]
    run.ended(run.start("--resume"))


# A case is a function of a Run, which leaves a finished run or sets `found`: its results, none if nothing is left.
CASES: dict[str, Callable[[Run], None]] = {
    "killed": killed,
    "terminated": terminated,
    "full_disk": full_disk,
    "removed": removed,
    "two_at_once": two_at_once,
    "input_changed": input_changed,
}
RANDOM = "random_moments"


def at_random(kind: type[Run], place: Path, expected: dict, seconds: float) -> int:
    """Each signal at ten random moments of a run, imports among them. Then the run goes on, or begins if it had not."""
    wrong, number = 0, 0
    moments = random.Random(0)
    for sent in SIGNALS:
        good = reached = 0
        while reached < MOMENTS:
            run = kind(place / f"random_{number}", place)
            number += 1
            moment, begin = moments.uniform(0.0, seconds), time.monotonic()
            process = run.start()
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                process.send_signal(sent)
            else:  # the run was faster than the one without a fault
                run.end(process)
                seconds = time.monotonic() - begin
                continue
            reached += 1
            code, _ = run.end(process)
            steps, again = run.steps_done(), 0
            if not (run.output / "metrics.json").exists():
                again, lines = run.end(run.start("--resume"))
                if again == 2 and "to resume" in lines[-1]:
                    again, _ = run.end(run.start())
            same = again == 0 and run.result() == expected
            good += same
            said = "same" if same else "DIFFERENT"
            print(f"    {sent.name} after {moment:4.1f} s: exit code {code}, {steps} steps: {said}")
        print(f"    {sent.name}: the same bits {good} of {MOMENTS} times")
        wrong += MOMENTS - good
    return wrong


@contextmanager
def small_disk(place: Path, size: str = "3m"):
    """A file system in memory; raises PermissionError where it may not be mounted."""
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", place], capture_output=True, text=True
    )
    if done.returncode:
        raise PermissionError(done.stderr.strip())
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", place], check=True)


def disturb(kind: type[Run], names: list[str], place: Path) -> int:
    """The cases of a kind of run; returns the number of those that did not end as they should."""
    wrong = 0
    warm = kind(place / "warm", place)
    warm.end(warm.start())  # compiled programs are kept from here on
    straight, start = kind(place / "straight", place), time.monotonic()
    print(f"{kind.name}: {kind.steps} steps without a fault")
    straight.ended(straight.start())
    seconds, expected = time.monotonic() - start, straight.result()
    for name in names:
        if name == RANDOM:
            print(f"{name}: {at_random.__doc__}")
            wrong += at_random(kind, place, expected, seconds)
            continue
        run = kind(place / name, place)
        print(f"{name}: {CASES[name].__doc__}")
        try:
            CASES[name](run)
        except PermissionError as problem:
            print(f"    left out: no small file system can be mounted here ({problem})")
            continue
        found = run.result() if run.found is None else run.found
        different = [key for key in found if found[key] != expected[key]]
        wrong += bool(different)
        if found:
            print("    the same bits as without the fault" if not different else f"    DIFFERENT: {different}")
    return wrong


def main() -> int:
    """Run the cases; the exit code is the number of those that did not end as they should."""
    kinds = {kind.name: kind for kind in (Run, Reconstruction)}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=[*kinds], help="only these runs")
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join([*CASES, RANDOM])}; default: all")
    options = parser.parse_args()
    # What a shell starts in the background ignores Ctrl-C, and so would the runs.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    wrong = 0
    for name in [options.kind] if options.kind else [*kinds]:
        with tempfile.TemporaryDirectory() as place:
            wrong += disturb(kinds[name], options.cases or [*CASES, RANDOM], Path(place))
    return wrong


if __name__ == "__main__":
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    sys.exit(main())
