"""Folders of results: known by a marker that only we write, used by one run at a time, resumed by their config.

`jaxdr.json` is the marker. It is the first file of a run, and says the kind of results and the digests of the inputs.
"""

import contextlib
import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from jaxdr.atomic_file import PARTIAL, CannotWrite, atomic_path, remove_partial
from jaxdr.optimize.checkpoint import differences
from jaxdr.untrusted import is_own_file, json_text, read_json

MARKER, LOCK = "jaxdr.json", ".jaxdr.lock"
VERSION = 1  # of the marker
FILE_KEYS = ("path", "file", "images", "mesh", "albedo", "velocities")  # what the keys of files in configs are called


@dataclasses.dataclass(frozen=True)
class Results:
    """What a folder of results is.

    - `kind`: of results, in words. `config`: a dataclass, kept as JSON in the file `config_file`. Its fields `free` may
      differ where a run goes on.
    - `writes`: patterns of the files that a run writes, relative to the folder.
    - `inputs`: files and folders that are read, by the names under which their contents are remembered.
    """

    path: Path
    kind: str
    config: Any
    config_file: str
    free: Sequence[str]
    writes: Sequence[str]
    inputs: Mapping[str, Path]


@contextlib.contextmanager
def results_folder(results: Results, resume: bool, overwrite: bool) -> Iterator[None]:
    """Inside the block the folder is this run's alone: made, or checked to be the one to go on with.

    With `overwrite`, the files that runs of this kind write are deleted, by name, and nothing else is. A process that
    is killed leaves the folder free.

    Raises ValueError, and changes nothing, where

    - the folder holds results and neither `resume` nor `overwrite` is given, or it is the folder of something else;
    - there is nothing to resume, or the config or the contents of an input differ;
    - an input lies in the folder, or the folder lies in an input;
    - another run is at work there.
    """
    if resume and overwrite:
        raise ValueError("--resume and --overwrite exclude each other: one keeps the results, one deletes them")
    _check_apart(results)
    _check(results, resume, overwrite)
    try:
        results.path.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise CannotWrite.of(results.path, problem) from problem
    with _alone(results.path):
        _check(results, resume, overwrite)  # another run may have come between
        _open(results, resume)
        yield


def settled(config: Any, free: Sequence[str]) -> dict:
    """A config as JSON has it, without its fields `free`, which do not change the result."""
    table = json.loads(json.dumps(dataclasses.asdict(config)))
    return {name: value for name, value in table.items() if name not in free}


def files_of(config: Any) -> dict[str, Path]:
    """The files that a config names, by themselves: see `FILE_KEYS`."""

    def found(value: Any, key: str) -> Iterator[str]:
        if isinstance(value, dict):
            for name, part in value.items():
                yield from found(part, name)
        elif isinstance(value, list | tuple):
            for part in value:
                yield from found(part, key)
        elif isinstance(value, str) and value and key in FILE_KEYS:
            yield value

    return {name: Path(name) for name in found(dataclasses.asdict(config), "")}


def _check_apart(results: Results) -> None:
    output = results.path.resolve()
    for given in results.inputs.values():
        found = given.resolve()
        if output == found or output.is_relative_to(found) or found.is_relative_to(output):
            place = "is" if output == found else "lies in" if output.is_relative_to(found) else "holds"
            raise ValueError(f"output {results.path}: {place} the input {given}; choose another folder")


def _check(results: Results, resume: bool, overwrite: bool) -> None:
    """Raises ValueError where this run must not use the folder. Changes nothing."""
    path, kind = results.path, results.kind
    if path.exists() and not path.is_dir():
        raise ValueError(f"output {path}: is a file; expected a folder")
    begun = path.exists() and (path / results.config_file).exists()
    if resume and not begun:
        raise ValueError(f"output {path}: there is no {kind} to resume")
    marker = _marker(path)
    if marker is not None and marker["kind"] != kind:
        raise ValueError(f"output {path}: holds a {marker['kind']}, this is a {kind}; choose another output")
    if resume:
        _check_config(results)
    elif marker is None and path.exists() and any(_entries(path)):
        old = "; results of an older version are not deleted: delete them yourself, or" if begun else ";"
        raise ValueError(
            f"output {path}: is not empty and not the folder of a {kind} (it has no {MARKER}){old} choose another one"
        )
    elif begun and not overwrite:
        raise ValueError(f"output {path}: already holds results; give --resume or --overwrite")


def _open(results: Results, resume: bool) -> None:
    path, marker = results.path, _marker(results.path)
    if resume and marker is not None:
        _check_inputs(results, marker["inputs"])  # here, once: it reads all of them
    remove_partial(path)
    if not resume:
        _delete(path, (*results.writes, results.config_file))
    if not resume or marker is None:
        digests = {name: _digest(file) for name, file in results.inputs.items() if file.is_file()}
        head = {"jaxdr": "results", "kind": results.kind, "version": VERSION, "inputs": digests}
        _write(path / MARKER, head)
        _write(path / results.config_file, dataclasses.asdict(results.config))


def _write(path: Path, table: dict) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json_text(table), encoding="utf-8")


def _entries(path: Path) -> Iterator[Path]:
    """What is in a folder, except what a run leaves that was stopped before its first file."""
    return (entry for entry in path.iterdir() if entry.name != LOCK and not entry.name.startswith(PARTIAL))


def _marker(path: Path) -> dict | None:
    """What the marker says; None where there is none. Raises ValueError for a file of this name that is no marker."""
    file = path / MARKER
    if not is_own_file(file):
        return None
    found = read_json(file)
    good = isinstance(found, dict) and found.get("jaxdr") == "results" and isinstance(found.get("inputs"), dict)
    if not (good and isinstance(found.get("kind"), str)):
        raise ValueError(f"{file}: is not the marker of a folder of results; choose another output")
    if found.get("version") != VERSION:
        raise ValueError(f"{file}: is of another version of jaxdr; go on with that one, or choose another output")
    return found


def _delete(path: Path, patterns: Sequence[str]) -> None:
    """Delete files by name, and folders that are empty then. Links are deleted, what they point to is not."""
    for pattern in patterns:
        parts = pattern.split("/")
        folders = [path.joinpath(*parts[:n]) for n in range(1, len(parts))]
        if any(folder.is_symlink() for folder in folders):
            continue  # it leads out of the folder
        for file in sorted(path.glob(pattern)):
            if file.is_symlink() or file.is_file():
                file.unlink()
    for folder in sorted({path / pattern.rpartition("/")[0] for pattern in patterns if "/" in pattern}, reverse=True):
        if folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir()):
            folder.rmdir()


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system takes back from a process that ends. Raises ValueError if it is held."""
    lock = FileLock(path / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise ValueError(
            f"output {path}: another run is at work there; wait for its end, stop it, or choose another output"
        ) from None
    except OSError as problem:
        raise CannotWrite.of(path / LOCK, problem) from problem
    try:
        yield
    finally:
        lock.release()


def _check_config(results: Results) -> None:
    file = results.path / results.config_file
    old = read_json(file)
    if not isinstance(old, dict):
        raise ValueError(f"{file}: is damaged (expected a table); start again with --overwrite")
    old = {name: value for name, value in old.items() if name not in results.free}
    if changed := differences(old, settled(results.config, results.free)):
        raise ValueError(
            f"output {results.path}: can't resume, the config differs from the {results.kind}'s: {'; '.join(changed)}"
        )


def _check_inputs(results: Results, digests: Mapping[str, Any]) -> None:
    """Raises ValueError where an input of the run has other contents now."""
    for name, digest in digests.items():
        file = results.inputs.get(name)
        if file is None or not file.is_file():
            raise ValueError(f"{name}: was read when the run began, and is missing now; put it back")
        if _digest(file) != digest:
            raise ValueError(
                f"{file}: has other contents than when the run began; put the old file back, or start again with "
                "--overwrite"
            )


def _digest(file: Path) -> str:
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
