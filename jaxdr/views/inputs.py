"""The files that a folder of photographs consists of."""

import os
from pathlib import Path

from jaxdr.views.colmap import find_model
from jaxdr.views.record import Views
from jaxdr.views.transforms import ALL, TEST, TRAIN


def input_files(views: Views) -> dict[str, Path]:
    """Photographs, masks, and the files of their cameras, by their names relative to the folder."""
    folder = views.folder
    files = [file for view in views.views for file in (view.path, view.mask) if file is not None]
    files += [folder / name for name in (TRAIN, TEST, ALL) if (folder / name).is_file()]
    if (model := find_model(folder)) is not None:
        names = ("cameras", "images", "rigs", "frames")
        files += [file for name in names for file in sorted(model.glob(f"{name}.*")) if file.is_file()]
    return {os.path.relpath(file, folder): file for file in files}
