"""XLA's persistent compilation cache in a folder of the user, for commands and tests, which compile the same programs.

JAX's key of a program contains everything that it is compiled from (operations and their attributes, options, versions,
the processor). Programs with host callbacks are not kept. Warp's callables write no number of this process into a
program (`geometry.queries.warp.records.Call`).
"""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import jax
from filelock import FileLock, Timeout

SIZE = 2 << 30  # bytes; beyond, the programs that were not used for longest are deleted


def user_folder(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> Path:
    """This package's cache folder on this platform."""
    home = Path.home()
    if platform == "win32":
        base = environment.get("LOCALAPPDATA") or home / "AppData" / "Local"
    elif platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = environment.get("XDG_CACHE_HOME") or home / ".cache"
    return Path(base) / "jaxdr"


def keep_programs(folder: Path) -> Path:
    """Keep compiled programs in a folder from now on, or in the one that JAX already has; returns the folder.

    Processes may share it. Raises OSError if the folder is not writable.
    """
    # JAX adds its options as attributes at run time, and its class declares only some of them.
    chosen = jax.config.jax_compilation_cache_dir  # type: ignore[reportAttributeAccessIssue]
    if chosen:
        return Path(chosen)
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{folder} is not writable")
    _mend(folder)
    # With a limit JAX also locks the folder. Without it a process can read a program that another is still writing.
    jax.config.update("jax_compilation_cache_max_size", SIZE)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    return folder


def _mend(folder: Path) -> None:
    """Delete programs without a time of last use, left by stopped processes: beside them JAX keeps no new programs."""
    try:
        with FileLock(folder / ".lockfile", timeout=1):  # JAX's own lock
            for program in folder.glob("*-cache"):
                if not program.with_name(program.name.removesuffix("-cache") + "-atime").exists():
                    program.unlink()
    except Timeout:
        pass  # another process uses the folder; the next start deletes them


def leave_out() -> None:
    """Neither read nor keep any compiled program in this process."""
    jax.config.update("jax_enable_compilation_cache", False)
