"""Warnings that name the user's line, past all frames of this library and of JAX."""

import sys
import warnings
from types import FrameType

# Packages whose frames are not the caller's.
INNER = {"jaxdr", "jax", "jaxlib", "equinox", "jaxtyping", "beartype"}


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """`warnings.warn` at the first frame outside `INNER`. By default Python shows it once for each line and text."""
    # From Python 3.12 on, `skip_file_prefixes` does this.
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and _inner(frame):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def _inner(frame: FrameType) -> bool:
    # Code that beartype generates has its own globals, and no file.
    package = frame.f_globals.get("__name__", "").partition(".")[0]
    return package in INNER or frame.f_code.co_filename.startswith("<@")
