"""Folders of results: never overwritten unasked, and resumed by the config that began them alone."""

import dataclasses
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxdr.atomic_file import atomic_path, remove_partial
from jaxdr.optimize.checkpoint import differences


def open_results(
    path: Path,
    config: Any,
    resume: bool,
    overwrite: bool,
    kind: str = "run",
    marker: str = "config.json",
    free: Sequence[str] = ("output",),
) -> None:
    """Make the folder of a `kind` of results, or check that it is the one to go on with.

    `config` is a dataclass, kept as JSON in the file `marker`. Its fields `free` may differ where a run goes on.

    Raises ValueError where the folder holds results and neither `resume` nor `overwrite` is given, and where it is the
    folder of something else. With `resume`, raises ValueError where there is nothing to resume, or the config differs.
    """
    if resume and overwrite:
        raise ValueError("--resume and --overwrite exclude each other: one keeps the results, one deletes them")
    if resume:
        _check_config(path, config, kind, marker, free)
        remove_partial(path)
        return
    if path.exists() and not path.is_dir():
        raise ValueError(f"output {path}: is a file; expected a folder")
    if path.exists() and any(path.iterdir()):
        if not (path / marker).exists():
            raise ValueError(f"output {path}: is not empty and not the folder of a {kind}; choose another one")
        if not overwrite:
            raise ValueError(f"output {path}: already holds results; give --resume or --overwrite")
        shutil.rmtree(path)
    path.mkdir(parents=True, exist_ok=True)
    with atomic_path(path / marker) as temporary:
        temporary.write_text(json.dumps(dataclasses.asdict(config), indent=2))


def settled(config: Any, free: Sequence[str]) -> dict:
    """A config as JSON has it, without its fields `free`, which do not change the result."""
    table = json.loads(json.dumps(dataclasses.asdict(config)))
    return {name: value for name, value in table.items() if name not in free}


def _check_config(path: Path, config: Any, kind: str, marker: str, free: Sequence[str]) -> None:
    try:
        old = json.loads((path / marker).read_text())
    except FileNotFoundError:
        raise ValueError(f"output {path}: there is no {kind} to resume") from None
    except json.JSONDecodeError as problem:
        raise ValueError(f"output {path}: {marker} is damaged ({problem})") from None
    old = {name: value for name, value in old.items() if name not in free}
    changed = differences(old, settled(config, free))
    if changed:
        raise ValueError(f"output {path}: can't resume, the config differs from the {kind}'s: {'; '.join(changed)}")
