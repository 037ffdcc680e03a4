"""Warp without its lines on the screen: it writes a banner when it starts, and a line for each module that it loads.

A library prints nothing. But Warp's level of messages is one for the whole process, and belongs to programs that use
Warp themselves. So it is changed only while we start Warp or load our own modules, and only from Warp's default.
"""

import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import warp as wp

# Written by Warp's C++ to file descriptor 2, whatever the level. It is no news where JAX computes on CPUs.
NO_DRIVER = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver."

_lock = threading.Lock()


def start_warp() -> None:
    """Start Warp, if nobody did, without its banner and without its warning that there is no CUDA driver."""
    with _lock:
        _start_warp()


@cache
def _start_warp() -> None:
    with quiet(), _without(NO_DRIVER):
        wp.init()


def load_module(kernel, device) -> None:
    """Compile or load a kernel's module before threads launch it; the lock is for programs that run in parallel."""
    with _lock, quiet():
        wp.load_module(kernel.module, device=device)


@contextmanager
def quiet() -> Iterator[None]:
    """A context in which Warp writes warnings and errors only, unless somebody chose a level."""
    level = wp.config.log_level
    if level != wp.LOG_INFO:  # somebody chose a level
        yield
        return
    with wp.ScopedLogLevel(wp.LOG_WARNING):
        yield


@contextmanager
def _without(start: bytes) -> Iterator[None]:
    """Keep lines that begin so from file descriptor 2. All else is written at the end, in its order."""
    try:
        kept = os.dup(2)
    except OSError:  # there is none
        yield
        return
    with tempfile.TemporaryFile() as file:
        try:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(file.fileno(), 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            os.write(2, b"".join(line for line in file if not line.startswith(start)))
