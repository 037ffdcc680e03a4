"""The contents of a folder of results: its kind, pictures and meshes by name and step, and paths of its tables."""

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxdr.untrusted import is_own_file, read_json

PICTURES = (".png", ".jpg", ".jpeg", ".gif", ".exr", ".hdr", ".pfm")
MESHES = (".glb", ".ply", ".obj", ".stl")  # of files with the same name the first kind is shown
MARKERS = ("config.json", "chart.json")
FOLDERS = ("", "pictures", "meshes", "test", "compared")


class Item(NamedTuple):
    """A file of a run. `step` is that of the optimiser; None for files that belong to no step."""

    name: str
    step: int | None
    path: Path


class Results(NamedTuple):
    """Everything that a page shows. Paths of files that the folder does not have are None.

    `compared`: photographs beside renderings. `left_out`: pictures, meshes and folders that are links or no regular
    files. A page is sent to others, and what a link leads to may be private.
    """

    path: Path
    kind: str
    finished: bool
    pictures: Sequence[Item]
    meshes: Sequence[Item]
    held_out: Sequence[Item]
    compared: Sequence[Item]
    metrics: Path | None
    rows: Path | None
    summary: Path | None
    config: Path
    left_out: Sequence[Path] = ()


def read_folder(path: Path) -> Results:
    """The contents of the folder of a run or of a chart. Raises ValueError if it is neither, or has nothing to show.

    The folder may be a link. Its tables must not: that is a ValueError, too. Other links are left out.
    """
    if not path.exists():
        raise ValueError(f"{path}: there is no such folder")
    if not path.is_dir():
        raise ValueError(f"{path}: is a file; expected the folder of a run or of a chart")
    if not any(path.iterdir()):
        raise ValueError(f"{path}: is empty; expected the folder of a run or of a chart")
    config = _existing(path, *MARKERS)
    if config is None:
        raise ValueError(f"{path}: is not the folder of a run or of a chart: it has no {' or '.join(MARKERS)}")
    summary = _existing(path, "metrics.json", "summary.json")
    files, left_out = _files(path)
    results = Results(
        path,
        _kind(config),
        summary is not None,
        [*_items(files[""], PICTURES), *_items(files["pictures"], PICTURES)],
        _one_of_each([*_items(files[""], MESHES), *_items(files["meshes"], MESHES)]),
        _items(files["test"], PICTURES),
        _items(files["compared"], PICTURES),
        _existing(path, "metrics.csv"),
        _existing(path, "rows.csv"),
        summary,
        config,
        left_out,
    )
    pictures = (results.pictures, results.held_out, results.compared)
    if not any((*pictures, results.meshes, results.metrics, results.rows, results.summary)):
        links = "has nothing to show but links, which are left out; put copies there"
        raise ValueError(f"{path}: {links if left_out else 'has nothing to show yet; run it first'}")
    return results


def spread(items: Sequence[Item], most: int) -> list[Item]:
    """At most `most` of the items, evenly spread, with the first and the last."""
    if len(items) <= most:
        return list(items)
    return [items[round(i * (len(items) - 1) / (most - 1))] for i in range(most)]


def by_name(items: Iterable[Item]) -> dict[str, list[Item]]:
    """Items that belong to a step, by name, in the order of their steps."""
    groups: dict[str, list[Item]] = {}
    for item in sorted((item for item in items if item.step is not None), key=lambda item: item.step or 0):
        groups.setdefault(item.name, []).append(item)
    return groups


def _kind(config: Path) -> str:
    table = read_json(config)
    kinds = {"unknown": "reconstruction", "scene": "recovery", "target": "optimisation"}
    known = ["chart"] if config.name == "chart.json" else [kind for key, kind in kinds.items() if _has(table, key)]
    if not known or not isinstance(table, dict):
        raise ValueError(f"{config}: is not the config of a run")
    return known[0]


def _has(table: Any, key: str) -> bool:
    return isinstance(table, dict) and key in table


def _existing(path: Path, *names: str) -> Path | None:
    """The first of the files that the folder has. Raises ValueError for a link, and for what is no file."""
    found = next((path / name for name in names if os.path.lexists(path / name)), None)
    if found is not None and not is_own_file(found):
        raise ValueError(f"{found}: is a link or no regular file, which is not shown to others; put a copy there")
    return found


def _files(path: Path) -> tuple[dict[str, list[Path]], list[Path]]:
    """(pictures and meshes by folder, those that are left out). Names that begin with a dot do not count."""
    files: dict[str, list[Path]] = {name: [] for name in FOLDERS}
    left_out = []
    for name, found in files.items():
        folder = path / name
        if name and folder.is_symlink():
            left_out.append(folder)
            continue
        for file in sorted(folder.iterdir(), key=_natural) if folder.is_dir() else []:
            if file.suffix.lower() in (*PICTURES, *MESHES) and not file.name.startswith("."):
                (found if is_own_file(file) else left_out).append(file)
    return files, left_out


def _items(files: Sequence[Path], suffixes: tuple[str, ...]) -> list[Item]:
    """Files with one of the suffixes. Pictures and meshes `NNNNN.ext` and `NNNNN.NAME.ext` belong to step NNNNN."""
    found = []
    for path in files:
        if path.suffix.lower() in suffixes:
            number, _, name = path.stem.partition(".")
            is_step = number.isdecimal() and path.parent.name in ("pictures", "meshes")
            found.append(Item(name if is_step else path.stem, int(number) if is_step else None, path))
    return found


def _natural(path: Path) -> list[tuple[int, str]]:
    """A sort key that puts numbers in names in order: r_2 before r_10."""
    return [(int(piece), "") if piece.isdecimal() else (-1, piece) for piece in re.split(r"(\d+)", path.name)]


def _one_of_each(items: Sequence[Item]) -> list[Item]:
    """The items without duplicates. Of files that differ by the extension only, the first kind in `MESHES` stays."""
    best: dict[Path, Item] = {}
    for item in sorted(items, key=lambda item: MESHES.index(item.path.suffix.lower())):
        best.setdefault(item.path.with_suffix(""), item)
    return [item for item in items if best[item.path.with_suffix("")] is item]
