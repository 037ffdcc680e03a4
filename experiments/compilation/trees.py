"""The versions of jaxdr to compare: this one, and checkouts of other versions."""

import os
import subprocess
import sys
from pathlib import Path

from experiments.common import ROOT

HERE = "this version"


def versions(others: list[Path]) -> dict[str, Path]:
    """Label -> root of a checkout, this one first; others go by the name of their folder."""
    found = {HERE: ROOT} | {path.resolve().name: path.resolve() for path in others}
    for label, path in found.items():
        if not (path / "jaxdr/__init__.py").exists():
            raise SystemExit(f"--tree: no jaxdr in {path} ({label})")
    if len(found) != 1 + len(others):
        raise SystemExit("--tree: folders of the same name can't be told apart")
    return found


def use(tree: Path) -> None:
    """Import jaxdr from `tree`; for the start of a fresh process: the rest of `experiments` stays this version's."""
    if "jaxdr" in sys.modules:
        raise RuntimeError("jaxdr was imported before its version was chosen")
    sys.path.insert(0, str(tree))
    try:
        import jaxdr
    finally:
        sys.path.remove(str(tree))
    if not Path(jaxdr.__file__).resolve().is_relative_to(tree):
        raise RuntimeError(f"{jaxdr.__file__} is not in {tree}")


def import_seconds(tree: Path) -> float:
    """Seconds of `import jaxdr` in an interpreter of its own."""
    timed = "import time; start = time.perf_counter(); import jaxdr; print(time.perf_counter() - start)"
    environment = os.environ | {"PYTHONPATH": str(tree)}
    answer = subprocess.run(
        [sys.executable, "-c", timed], cwd=tree, env=environment, stdout=subprocess.PIPE, check=True
    )
    return float(answer.stdout.split()[-1])


def lines_of_code(tree: Path) -> dict[str, int]:
    """Lines of Python by room of the package; modules outside of any room as "jaxdr", and all of them as "sum"."""
    counts: dict[str, int] = {}
    for path in sorted((tree / "jaxdr").rglob("*.py")):
        parts = path.relative_to(tree / "jaxdr").parts
        room = parts[0] if len(parts) > 1 else "jaxdr"
        counts[room] = counts.get(room, 0) + len(path.read_text().splitlines())
    return counts | {"sum": sum(counts.values())}
