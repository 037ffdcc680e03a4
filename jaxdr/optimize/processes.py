"""Runs of several processes, on one host or many: one of them writes, and all take the same decisions."""

import contextlib
import io
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

import jax
import numpy as np
from jax.experimental import multihost_utils

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.run_files import RunFiles

# How errors of collective operations begin. JAX raises them as one class or another.
STATUS = re.compile("(ABORTED|CANCELLED|DEADLINE_EXCEEDED|FAILED_PRECONDITION|INTERNAL|UNAVAILABLE|UNKNOWN): ")
PROBLEM = "what went wrong"  # the name of an error among arrays
HEARTBEAT = 30  # seconds without a sign of life after which a process counts as lost


class ProcessLost(Exception):
    """Another process of the run has ended, or can't be reached; the message says how to go on."""


def start_processes(coordinator: str | None, count: int | None, number: int | None) -> None:
    """Join the processes of a run, before anything is computed. Without arguments the cluster says which they are.

    `coordinator`: HOST:PORT of process 0, which listens at this address alone; the channel is not authenticated. JAX
    finds all three under SLURM, Open MPI and Kubernetes. Raises ValueError where something is missing, or the processes
    don't find one another.
    """
    try:
        # Left out, JAX would listen at all addresses of the host.
        jax.distributed.initialize(
            *(coordinator, count, number),
            coordinator_bind_address=coordinator,
            heartbeat_timeout_seconds=HEARTBEAT,
        )
    except (ValueError, TypeError) as problem:
        raise ValueError(
            f"processes: the cluster does not say where the others are ({problem}); give "
            "--coordinator HOST:PORT, --processes N and --process I"
        ) from None
    except RuntimeError as problem:
        raise ValueError(f"processes: can't join the others at {coordinator}: {problem}") from None


def is_writer() -> bool:
    """Whether this process writes what the run leaves."""
    return jax.process_index() == 0


def of_writer(function: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """What `function` returns in the writing process, given to all processes; the others don't call it.

    An error there is a ValueError in the others.
    """
    if jax.process_count() == 1:
        return function()
    arrays: dict[str, np.ndarray] = {}
    problem: Exception | None = None
    if is_writer():
        try:
            arrays = function()
        except Exception as caught:  # the others wait for this process, so tell them first
            problem = caught
            arrays = {PROBLEM: np.asarray(str(caught))}
    with io.BytesIO() as file:
        np.savez(file, allow_pickle=False, **{f"value_{name}": value for name, value in arrays.items()})
        data = _broadcast(file.getvalue())
    if problem is not None:
        raise problem
    with np.load(io.BytesIO(data), allow_pickle=False) as found:
        arrays = {name.removeprefix("value_"): found[name] for name in found.files}
    if PROBLEM in arrays:
        raise ValueError(str(arrays[PROBLEM]))
    return arrays


def _broadcast(data: bytes) -> bytes:
    """The bytes that the writing process has, in every process."""
    length = int(multihost_utils.broadcast_one_to_all(np.asarray(len(data), np.int64)))
    words = np.zeros(length, np.uint8)
    if is_writer():
        words[:] = np.frombuffer(data, np.uint8)
    return np.asarray(multihost_utils.broadcast_one_to_all(words)).tobytes()


def any_process(flag: bool) -> bool:
    """Whether the flag is set in any process: all call this at the same place."""
    if jax.process_count() == 1:
        return flag
    return bool(np.any(multihost_utils.process_allgather(np.asarray(flag))))


def mesh_of_writer(make: Callable[[], Mesh]) -> Mesh:
    """The mesh that the writing process makes: rounding may differ between hosts, and so may what remeshing finds."""
    if jax.process_count() == 1:
        return make()

    def arrays():
        mesh = make()
        smooth = np.asarray(mesh.normal_faces is not None)
        made = {"vertices": np.asarray(mesh.vertices), "faces": np.asarray(mesh.faces), "smooth": smooth}
        if mesh.uvs is not None:
            made |= {"uvs": np.asarray(mesh.uvs), "uv_faces": np.asarray(mesh.uv_faces)}
        return made

    found = of_writer(arrays)
    mesh = Mesh(found["vertices"], found["faces"], found.get("uvs"), found.get("uv_faces"))
    return mesh.smooth() if found["smooth"] else mesh


@contextlib.contextmanager
def folder_of_process(folder: RunFiles, resume: bool, overwrite: bool) -> Iterator[RunFiles]:
    """The folder in which this process works on a run, made or checked; that of the writing process is `folder`.

    Others have one of their own, with copies of the files that a run goes on from, which is deleted in the end: they
    need not see the same file system. A ValueError of the writing process is raised in all.
    """
    with contextlib.ExitStack() as until_the_end:
        if jax.process_count() == 1:
            until_the_end.enter_context(folder.opened(resume, overwrite))
            yield folder
            return

        def files_of_writer():
            until_the_end.enter_context(folder.opened(resume, overwrite))
            kept = [p for p in sorted(folder.path.iterdir()) if p.is_file()] if resume else []
            return {p.name: np.frombuffer(p.read_bytes(), np.uint8) for p in kept}

        files = of_writer(files_of_writer)
        if is_writer():
            yield folder
            return
        own = until_the_end.enter_context(
            tempfile.TemporaryDirectory(prefix="jaxdr-process-", ignore_cleanup_errors=True)
        )
        for name, content in files.items():
            (Path(own) / name).write_bytes(content.tobytes())
        there = folder.at(Path(own))
        until_the_end.enter_context(there.opened(resume, overwrite=False))
        yield there


@contextlib.contextmanager
def told_of_lost_processes(checkpoint: Path) -> Iterator[None]:
    """Inside the block, what JAX reports of a lost process becomes a `ProcessLost` that says how to go on."""
    try:
        yield
    except Exception as problem:
        if jax.process_count() == 1 or not STATUS.match(str(problem)):
            raise
        raise ProcessLost(
            f"process {jax.process_index()} of {jax.process_count()} has lost another one "
            f"({str(problem).splitlines()[0]}); the last checkpoint is {checkpoint}; start all processes again "
            "with --resume"
        ) from problem


def leave_at_once(code: int) -> NoReturn:
    """End this process after it has lost another: JAX's own end would wait for that one, and abort."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
