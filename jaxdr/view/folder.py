"""The contents of a folder of results: its kind, pictures and meshes by name and step, and paths of its tables."""

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

PICTURES = (".png", ".jpg", ".jpeg", ".gif", ".exr", ".hdr", ".pfm")
MESHES = (".glb", ".ply", ".obj", ".stl")  # of files with the same name the first kind is shown
MARKERS = ("config.json", "chart.json")


class Item(NamedTuple):
    """A file of a run. `step` is that of the optimiser; None for files that belong to no step."""

    name: str
    step: int | None
    path: Path


class Results(NamedTuple):
    """Everything that a page shows. Paths of files that the folder does not have are None."""

    path: Path
    kind: str
    finished: bool
    pictures: Sequence[Item]
    meshes: Sequence[Item]
    held_out: Sequence[Item]
    metrics: Path | None
    rows: Path | None
    summary: Path | None
    config: Path


def read_folder(path: Path) -> Results:
    """The contents of the folder of a run or of a chart. Raises ValueError if it is neither, or has nothing to show."""
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
    results = Results(
        path,
        _kind(config),
        summary is not None,
        [*_items(path, PICTURES), *_items(path / "pictures", PICTURES)],
        _one_of_each([*_items(path, MESHES), *_items(path / "meshes", MESHES)]),
        _items(path / "test", PICTURES),
        _existing(path, "metrics.csv"),
        _existing(path, "rows.csv"),
        summary,
        config,
    )
    shown = (results.pictures, results.meshes, results.held_out, results.metrics, results.rows, results.summary)
    if not any(shown):
        raise ValueError(f"{path}: has nothing to show yet; run it first")
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
    if config.name == "chart.json":
        return "chart"
    try:
        table = json.loads(config.read_text(encoding="utf-8"))
    except ValueError as problem:
        raise ValueError(f"{config}: is damaged ({problem})") from None
    kinds = {"unknown": "reconstruction", "scene": "recovery", "target": "optimisation"}
    known = [kind for key, kind in kinds.items() if isinstance(table, dict) and key in table]
    if not known:
        raise ValueError(f"{config}: is not the config of a run")
    return known[0]


def _existing(path: Path, *names: str) -> Path | None:
    return next((path / name for name in names if (path / name).is_file()), None)


def _items(folder: Path, suffixes: tuple[str, ...]) -> list[Item]:
    """Files with one of the suffixes. Pictures and meshes `NNNNN.ext` and `NNNNN.NAME.ext` belong to step NNNNN."""
    found = []
    for path in sorted(folder.iterdir(), key=_natural) if folder.is_dir() else []:
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and path.is_file():
            number, _, name = path.stem.partition(".")
            is_step = number.isdecimal() and folder.name in ("pictures", "meshes")
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
