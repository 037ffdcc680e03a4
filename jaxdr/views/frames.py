"""A photograph as a folder describes it: what is known before its picture is read."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from jaxdr.callers_line import warn
from jaxdr.untrusted import finite
from jaxdr.views.lens import Lens
from jaxdr.views.pictures import MissingPicture

NAMED = 3  # pictures that a warning names

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Frame:
    """A photograph as a folder describes it. `source`: file and entry, for messages. `to_world`: as in `View`."""

    path: Path
    mask: Path | None
    to_world: Float[np.ndarray, "4 4"]
    source: str
    lens: Lens
    held_out: bool = False


def all_there(entries: Iterable[T], frame: Callable[[T], Frame], source: Path) -> list[Frame]:
    """The frames of entries whose pictures are there. `source`: the file that lists them.

    Warns of pictures that are missing, with a count. Raises ValueError if all of them are.
    """
    found: list[Frame] = []
    missing: list[MissingPicture] = []
    for entry in entries:
        try:
            found.append(frame(entry))
        except MissingPicture as problem:
            missing.append(problem)
    if missing and not found:
        raise missing[0]
    if missing:
        warn(
            f"{source}: {len(missing)} of {len(missing) + len(found)} pictures are missing and left out: "
            f"{some_of([problem.name for problem in missing])}"
        )
    return found


def some_of(names: Iterable[str]) -> str:
    """The first few names, and how many more there are."""
    names = list(names)
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def checked_pose(matrix, source: str) -> Float[np.ndarray, "4 4"]:
    """A camera-to-world matrix without scale, from [3, 4] or [4, 4]. Raises ValueError, with the source, otherwise."""
    rows = matrix.tolist() if isinstance(matrix, np.ndarray) else matrix
    if not (isinstance(rows, list) and len(rows) in (3, 4) and all(isinstance(r, list) and len(r) == 4 for r in rows)):
        raise ValueError(f"{source}: transform_matrix must be 4 x 4 finite numbers; write the pose anew")
    pose = np.array([[finite(value, f"{source}: transform_matrix") for value in row] for row in rows])
    if len(pose) == 3:
        pose = np.vstack([pose, [0, 0, 0, 1]])
    axes = pose[:3, :3]
    is_rotation = np.allclose(axes.T @ axes, np.eye(3), atol=1e-3) and np.linalg.det(axes) > 0
    if not (is_rotation and np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6)):
        raise ValueError(f"{source}: the pose must be a rotation and a translation (no scale, no mirror); normalise it")
    return pose
