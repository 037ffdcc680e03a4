"""Cameras for photographs that come alone, found before a reconstruction."""

import contextlib
from pathlib import Path

from jaxdr.optimize.progress import Progress
from jaxdr.optimize.run import Say
from jaxdr.views.camera_folder import MARKER
from jaxdr.views.load import has_cameras
from jaxdr.views.registration import Registration, find_cameras, report


def folder_with_cameras(photos: Path, output: Path, seed: int, overwrite: bool, say: Say) -> Path:
    """The folder itself where it has cameras; else one beside `output`, `OUTPUT-cameras`, in which they are found.

    Cameras that are there already are used, unless `overwrite`. Raises what `find_cameras` raises.
    """
    if has_cameras(photos) or not photos.is_dir():
        return photos
    cameras = output.with_name(f"{output.name}-cameras")
    if (cameras / MARKER).is_file() and not overwrite:
        say(f"{photos}: has no cameras; those in {cameras} are used")
        return cameras
    say(f"{photos}: has no cameras; they are looked for now, and kept in {cameras}")
    for line in report(find_cameras_with_bars(photos, cameras, seed, overwrite)):
        say(f"{cameras}: {line}")
    return cameras


def find_cameras_with_bars(photos: Path, output: Path, seed: int, overwrite: bool) -> Registration:
    """`find_cameras` with a progress bar for every stage."""
    with contextlib.ExitStack() as bars:
        stages: dict[str, Progress] = {}

        def progress(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                bars.close()  # the bar of the stage before
                stages[stage] = bars.enter_context(Progress(stage, total))
            while stages[stage].done < done:
                stages[stage].step()

        return find_cameras(photos, output, seed=seed, overwrite=overwrite, progress=progress)
