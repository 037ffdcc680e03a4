"""Machine code: compiled by the clang that Warp ships, kept on disk by its text, called by XLA by address."""

import contextlib
import ctypes
import hashlib
import os
import tempfile
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxdr.program_cache import user_folder

FLAGS = "-march=native -fno-slp-vectorize -fno-vectorize -ffp-contract=off -w"
KEPT = 4096  # objects on disk; beyond, those that were not used for longest are deleted
SYMBOL = "jaxdr_handler"
SHARED = "jaxdr_shared"  # of a kernel: where the address of `jaxdr_run` goes
TYPES = (
    "typedef __SIZE_TYPE__ size_t; typedef __INT64_TYPE__ int64_t; typedef __INT32_TYPE__ int32_t;\n"
    "typedef __UINT32_TYPE__ uint32_t; typedef __UINT64_TYPE__ uint64_t;\n"
)


class CompilerError(RuntimeError):
    """The compiler does not take a kernel, or is not there."""


class _Compiler(NamedTuple):
    """Warp's compiler, its library, which loads objects, and what machine code depends on beside its text."""

    compile: Callable[..., None]
    library: Any
    machine: str
    old_linker: bool


@cache
def _build() -> _Compiler:
    """Raises CompilerError if there is none. Warp has these functions, but does not document all of them."""
    try:
        import warp as wp  # here, because most of jaxdr starts without it
        from warp._src import build, context

        from jaxdr.quiet_warp import start_warp

        start_warp()
        if context.runtime.llvm is None:
            raise CompilerError("Warp has no compiler for the CPU on this machine")
        machine = f"{wp.get_cpu_kernel_cache_key(cpu_compiler_flags=FLAGS)} {FLAGS}"
        return _Compiler(build.build_cpu, context.runtime.llvm, machine, wp.config.legacy_cpu_linker)
    except (ImportError, AttributeError) as error:
        raise CompilerError(f"this version of Warp has another compiler: {error}") from error


def available() -> bool:
    """Whether kernels can be compiled here, for JAX's default backend."""
    try:
        return jax.default_backend() == "cpu" and bool(_build())
    except RuntimeError:  # a CompilerError, or Warp does not start
        return False


@cache
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=os.cpu_count() or 1)


@cache
def library_text(name: str) -> str:
    """A file of C++ of this package."""
    return Path(__file__).with_name(name).read_text()


@cache
def declarations() -> str:
    """XLA's own declarations, without other headers, and what handlers share: a text to begin with."""
    header = (Path(jax.ffi.include_dir()) / "xla" / "ffi" / "api" / "c_api.h").read_text()
    offset = "#define offsetof(type, field) __builtin_offsetof(type, field)\n"
    lines = [line for line in header.splitlines() if not line.startswith("#include")]
    return "\n".join([TYPES, offset, *lines, library_text("parallel.h")])


_targets: dict[str, Future] = {}
_lock = threading.Lock()


def target(text: str, kernel: bool = True) -> str:
    """The name of XLA's call of a kernel, or a handler; compiling begins in the background. See `ready`."""
    name = _name(text)
    with _lock:
        if name not in _targets:
            _targets[name] = _workers().submit(_register, name, text, kernel)
    return name


def ready(names: list[str]) -> None:
    """Wait until kernels can be called. Raises CompilerError for one that can't."""
    for name in names:
        _targets[name].result()


def _register(name: str, text: str, kernel: bool) -> None:
    address = _loaded(name, text)
    if kernel:
        ctypes.c_void_p.from_address(address(SHARED)).value = _run_address()
    register(name, address(SYMBOL))


def _run_address() -> int:
    """Of what all kernels share: to compile it with each of them would take longer than most kernels themselves."""
    with _linking:
        return _run_addresses()["jaxdr_run"]


@cache
def _run_addresses() -> dict[str, int]:
    return addresses(declarations() + library_text("kernel.h") + library_text("call.h"), ["jaxdr_run"])


_linking = threading.Lock()


def register(name: str, address: int) -> None:
    """Let XLA call the handler at an address by a name."""
    function = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(address)
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(function), platform="cpu")
    _kept_alive.append(function)


_kept_alive: list = []


def addresses(text: str, symbols: Sequence[str]) -> dict[str, int]:
    """Addresses of functions of a text. Raises CompilerError if it can't be compiled."""
    address = _loaded(_name(text), text)
    return {symbol: address(symbol) for symbol in symbols}


def _name(text: str) -> str:
    return "jaxdr_" + hashlib.sha256(f"{_build().machine}\n{text}".encode()).hexdigest()[:32]


def _loaded(name: str, text: str) -> Callable[[str], int]:
    """The addresses of an object's symbols, from an object on disk or a new one."""
    compiler = _build()
    library = compiler.library
    folder = _folder()
    path = folder / f"{name}.o"
    try:
        if path.exists():
            with contextlib.suppress(OSError):  # another user's
                os.utime(path)
        else:
            _compile(compiler, path, text)
            _bound(folder)
    except OSError as error:
        raise CompilerError(f"machine code can't be kept in {folder}: {error}") from error
    with _loading:  # Warp's loader is not safe for threads
        if library.wp_load_obj(str(path).encode(), name.encode(), compiler.old_linker) != 0:
            _drop(library, name, path)

    def address(symbol: str) -> int:
        with _loading:
            found = library.wp_lookup(name.encode(), symbol.encode())
            return found or _drop(library, name, path)

    return address


_loading = threading.Lock()


def _drop(library, name: str, path: Path):
    """Delete damaged machine code, so that the next process compiles it again; raises CompilerError."""
    library.wp_unload_obj(name.encode())
    path.unlink(missing_ok=True)
    raise CompilerError(f"the machine code {path} can't be loaded; it is deleted")


def _folder() -> Path:
    """The folder of objects: that of the user, or one of this process if that is not writable."""
    folder = user_folder() / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    except OSError:
        pass
    return _own_folder()


@cache
def _own_folder() -> Path:
    folder = tempfile.TemporaryDirectory(prefix="jaxdr_kernels_")
    _kept_alive.append(folder)  # it is deleted when the process ends
    return Path(folder.name)


def _compile(compiler: _Compiler, path: Path, text: str) -> None:
    """Write an object at once: other processes see all of it or nothing."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        source, made = Path(folder) / "kernel.cpp", Path(folder) / "kernel.o"
        source.write_text(text)
        try:
            compiler.compile(str(made), str(source), fuse_fp=False, extra_flags=FLAGS)
        except Exception as error:
            raise CompilerError(f"Warp's compiler does not take a kernel: {error}") from error
        os.replace(made, path)


def _bound(folder: Path) -> None:
    """Delete the objects that were not used for longest."""

    def used(path: Path) -> float:
        try:
            return path.stat().st_mtime
        except FileNotFoundError:  # another process has deleted it
            return 0.0

    objects = list(folder.glob("*.o"))
    for path in sorted(objects, key=used)[: max(0, len(objects) - KEPT)]:
        path.unlink(missing_ok=True)
