"""The files that a folder of photographs consists of."""

import os
from pathlib import Path

from jaxdr.views.load import LAYOUTS
from jaxdr.views.record import Views


def input_files(views: Views) -> dict[str, Path]:
    """Photographs, masks, and the files of their cameras, by their names relative to the folder."""
    folder = views.folder
    files = [file for view in views.views for file in (view.path, view.mask) if file is not None]
    files += [file for layout in LAYOUTS for file in layout.files(folder)]
    return {os.path.relpath(file, folder): file for file in files}
