"""The folder in which cameras are left: when it may be written to, and its links to the photographs and masks."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxdr.untrusted import is_own_file, json_text, read_json
from jaxdr.views.masks import FOLDERS, find_mask
from jaxdr.views.photographs import Photographs

MARKER = "registration.json"  # only we write it; it holds the numbers, too


def check_output(photos: Path, output: Path, overwrite: bool) -> None:
    """Raises ValueError where `output` must not be written to. Changes nothing."""
    here, there = output.resolve(), photos.resolve()
    if here == there or here.is_relative_to(there) or there.is_relative_to(here):
        place = "is" if here == there else "lies in" if here.is_relative_to(there) else "holds"
        raise ValueError(f"output {output}: {place} the input {photos}; choose another folder")
    if not os.path.lexists(output):
        return
    if output.is_symlink() or not output.is_dir():
        raise ValueError(f"output {output}: is a file; expected a folder")
    entries = {entry.name for entry in output.iterdir()}
    if not entries:
        return
    marker = output / MARKER
    table = read_json(marker) if is_own_file(marker) else None
    if not (isinstance(table, dict) and table.get("jaxdr") == "cameras" and isinstance(table.get("written"), list)):
        raise ValueError(
            f"output {output}: is not empty and not a folder of cameras (it has no {MARKER}); choose another"
        )
    if more := sorted(entries - set(table["written"])):
        raise ValueError(f"output {output}: holds {more[0]}, which was not written with the cameras; move it away")
    if not overwrite:
        raise ValueError(f"output {output}: already holds cameras; give --overwrite")


def mark(folder: Path, numbers: dict[str, Any]) -> None:
    """Write the marker, which says what is ours in a finished folder, with numbers about the cameras."""
    written = sorted([MARKER, *(entry.name for entry in folder.iterdir())])
    table = {"jaxdr": "cameras", "written": written, **numbers}
    (folder / MARKER).write_text(json_text(table), encoding="utf-8")


def link_all(found: Photographs, folder: Path, output: Path) -> None:
    """Put `images` and the folder of masks, if a photograph has a mask there, into the folder of cameras."""
    _link(found.folder, folder / "images", output, found.names)
    for parent in (found.folder, found.folder.parent):
        for name in FOLDERS:
            masks = [find_mask(parent, found.folder / photo, photo) for photo in found.names]
            inside = [mask for mask in masks if mask is not None and mask.is_relative_to(parent / name)]
            if inside:
                _link(parent / name, folder / name, output, [str(mask.relative_to(parent / name)) for mask in inside])
                return


def _link(source: Path, link: Path, output: Path, names: Sequence[str]) -> None:
    """A relative link to a folder, right once `link.parent` is `output`; where there are no links, copies of files."""
    try:
        link.symlink_to(os.path.relpath(source.resolve(), output.resolve()), target_is_directory=True)
    except (OSError, NotImplementedError, ValueError):  # ValueError: on another drive
        for name in names:
            (link / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / name, link / name)
