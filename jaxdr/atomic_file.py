"""Files and folders that appear complete or not at all, if a process is killed, the power fails or the disk is full."""

import contextlib
import errno
import os
import shutil
from pathlib import Path
from tempfile import NamedTemporaryFile, mkdtemp

PARTIAL = ".partial-"  # prefix of the names of incomplete files


class CannotWrite(OSError):
    """A file could not be written; the message says which and why. An earlier file of this name is intact."""

    @classmethod
    def of(cls, path: Path, problem: OSError) -> "CannotWrite":
        """The error `problem`, for this file."""
        reason = problem.strerror or str(problem)
        if problem.errno is None and _full(path.parent):  # NumPy and other libraries only report missing bytes
            reason = os.strerror(errno.ENOSPC)
        return cls(problem.errno or errno.EIO, reason, str(path))

    def __str__(self) -> str:
        return f"{self.filename}: can't be written ({self.strerror})"


class atomic_path:
    """Context manager: a temporary path beside `path`, which replaces `path` if the block ends without an error.

    The contents are written to disk before the name. So after a power failure there is the old file or the new one.
    Raises `CannotWrite` for every OSError, also in the block.
    """

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self) -> Path:
        try:
            with NamedTemporaryFile(
                dir=self.path.parent, suffix=self.path.suffix, prefix=PARTIAL, delete=False
            ) as file:
                self.temporary = Path(file.name)
        except OSError as problem:
            raise CannotWrite.of(self.path, problem) from problem
        return self.temporary

    def __exit__(self, kind, value, traceback) -> None:
        try:
            if kind is None:
                _flush(self.temporary)
                self.temporary.chmod(0o666 & ~_umask())
                os.replace(self.temporary, self.path)
                _flush_names(self.path.parent)
        except OSError as problem:
            kind, value = type(problem), problem
        told = CannotWrite.of(self.path, value) if isinstance(value, OSError) else None
        if kind is not None:
            with contextlib.suppress(OSError):  # the folder may be gone, or read-only by now
                self.temporary.unlink()
        if told is not None:
            raise told from value


class atomic_folder:
    """Context manager: a temporary folder beside `path`, which replaces `path` if the block ends without an error.

    Folders above it are made. What was at `path` is deleted after that, links in it but not what they point to. Raises
    `CannotWrite` for an OSError of the folders themselves; those of the block are its own.
    """

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self) -> Path:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.temporary = self._beside()
            self.temporary.chmod(0o777 & ~_umask())
        except OSError as problem:
            raise CannotWrite.of(self.path, problem) from problem
        return self.temporary

    def __exit__(self, kind, value, traceback) -> None:
        try:
            if kind is None:
                self._replace()
        except OSError as problem:
            raise CannotWrite.of(self.path, problem) from problem
        finally:
            shutil.rmtree(self.temporary, ignore_errors=True)

    def _replace(self) -> None:
        for file in self.temporary.rglob("*"):
            if file.is_file() and not file.is_symlink():
                _flush(file)
        old = None
        if self.path.exists():
            old = self._beside() / self.path.name
            os.replace(self.path, old)
        try:
            os.replace(self.temporary, self.path)
        except BaseException:
            if old is not None:
                os.replace(old, self.path)
            raise
        finally:
            if old is not None:
                shutil.rmtree(old.parent, ignore_errors=True)
        _flush_names(self.path.parent)

    def _beside(self) -> Path:
        return Path(mkdtemp(dir=self.path.parent, prefix=PARTIAL))


def append_text(path: Path, text: str) -> None:
    """Add to the end of a file. Raises `CannotWrite`; then a part of the text may have been written."""
    try:
        with open(path, "a", newline="") as file:
            file.write(text)
    except OSError as problem:
        raise CannotWrite.of(path, problem) from problem


def remove_partial(folder: Path) -> None:
    """Delete incomplete files and folders of killed processes in a folder and its subfolders."""
    for path in list(folder.rglob(f"{PARTIAL}*")):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _flush_names(folder: Path) -> None:
    if os.name != "posix":
        return  # elsewhere a folder can't be opened
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as problem:
        if problem.errno not in (errno.EINVAL, errno.ENOTSUP):  # network file systems may not support it
            raise
    finally:
        os.close(descriptor)


def _full(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < 1 << 16
    except OSError:
        return False


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
