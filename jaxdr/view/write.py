"""Writes the page of a folder. It overwrites no file but an earlier page."""

import os
from pathlib import Path

from jaxdr.atomic_file import atomic_path
from jaxdr.untrusted import is_own_file
from jaxdr.view.folder import read_folder
from jaxdr.view.page import GENERATOR, page

NAME = "view.html"
SUFFIXES = (".html", ".htm")


def write_page(folder: Path, output: Path | None = None) -> Path:
    """Write the page of a folder of results, by default as `view.html` in it. Returns its path.

    An earlier page is replaced. Raises ValueError for a folder without a run or with nothing to show, for files in it
    that can't be read, and for an output that can't be written or is another file.
    """
    results = read_folder(folder)
    path = folder / NAME if output is None else output
    _check_output(path)
    text = page(results)
    with atomic_path(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", "replace"))  # names of files may have characters that are none
    return path


def _check_output(path: Path) -> None:
    if path.is_dir():
        raise ValueError(f"output {path}: is a folder; expected an HTML file")
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"output {path}: expected a name that ends with {' or '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise ValueError(f"output {path}: folder {path.parent} does not exist")
    if os.path.lexists(path) and not (is_own_file(path) and _is_page(path)):
        raise ValueError(f"output {path}: is a file that jaxdr view did not write; choose another name")


def _is_page(path: Path) -> bool:
    with path.open("rb") as file:
        return GENERATOR.encode() in file.read(1000)
