"""XLA's persistent compilation cache, in a folder of the user's: for commands and tests, whose programs come again.

JAX's key of a program holds all that it is compiled from (operations and their attributes, options, versions, the
processor), and programs with host callbacks are left out. Warp's callables write no number of this process into a
program (`geometry.queries.warp.records.Call`).
"""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import jax
from filelock import FileLock, Timeout

SIZE = 2 << 30  # bytes, from where on the programs that were not used for longest are deleted


def user_folder(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> Path:
    """Where this platform keeps what can be computed again, of this package."""
    home = Path.home()
    if platform == "win32":
        base = environment.get("LOCALAPPDATA") or home / "AppData" / "Local"
    elif platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = environment.get("XDG_CACHE_HOME") or home / ".cache"
    return Path(base) / "jaxdr"


def keep_programs(folder: Path) -> Path:
    """Keep compiled programs in a folder from now on, unless JAX was told where to; returns where they are kept.

    Processes may share it. Raises OSError where nothing can be written.
    """
    # JAX makes its options attributes at run time, and its class declares only some of them.
    chosen = jax.config.jax_compilation_cache_dir  # type: ignore[reportAttributeAccessIssue]
    if chosen:
        return Path(chosen)
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{folder} is not writable")
    _mend(folder)
    # A limit makes JAX lock the folder as well; without one a process can read what another is still writing.
    jax.config.update("jax_compilation_cache_max_size", SIZE)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    return folder


def _mend(folder: Path) -> None:
    """Delete programs without a time of last use, which a stopped process leaves: JAX keeps none beside such a one."""
    try:
        with FileLock(folder / ".lockfile", timeout=1):  # the one of JAX
            for program in folder.glob("*-cache"):
                if not program.with_name(program.name.removesuffix("-cache") + "-atime").exists():
                    program.unlink()
    except Timeout:
        pass  # others are at work in it, and mend it at the next start


def leave_out() -> None:
    """Neither read nor keep any compiled program in this process."""
    jax.config.update("jax_enable_compilation_cache", False)
