"""Damaged files of a run that goes on: one error, which names the file."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.runs import read_run, write_run


def changed(run: Path, **arrays) -> None:
    """Put other arrays into the checkpoint."""
    path = run / "checkpoint.npz"
    with np.load(path) as file:
        old = {name: file[name] for name in file.files}
    np.savez(path, **old | arrays)


def encrypted(run: Path) -> None:
    """Mark the checkpoint's first array as encrypted: bit 0 of the flags, in the archive and in its directory."""
    path = run / "checkpoint.npz"
    content = bytearray(path.read_bytes())
    content[6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(content)


def pickled(run: Path) -> None:
    """An array of Python objects, which would run code when it is read."""
    path, array = run / "checkpoint.npz", io.BytesIO()
    np.save(array, np.array([{}], object), allow_pickle=True)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("more.npy", array.getvalue())


def text(name: str, content: bytes):
    """A damage: a file with this content."""
    return lambda run: (run / name).write_bytes(content)


def contents(run: Path) -> dict[Path, bytes]:
    """All files of a run."""
    return {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}


DAMAGES = {
    "a config that is a list": (text("config.json", b"[]"), "config.json"),
    "a config in no encoding": (text("config.json", b"\xff\xfe"), "config.json"),
    "a marker that is a list": (text("jaxdr.json", b"[]"), "jaxdr.json"),
    "metrics in no encoding": (text("metrics.csv", b"iteration\n\xff\xff\n"), "metrics.csv"),
    "a plan with a word as estimator": (text("plan.json", b'{"integrator": {"boundary": "x"}}'), "plan.json"),
    "a plan of arrays": (text("plan.json", b"[[]]"), "plan.json"),
    "an empty file of targets": (text("targets.npy", b""), "targets.npy"),
    "an empty checkpoint": (text("checkpoint.npz", b""), "checkpoint.npz"),
    "an encrypted checkpoint": (encrypted, "checkpoint.npz"),
    "a pickle": (pickled, "checkpoint.npz"),
    "a step below zero": (lambda run: changed(run, step=np.array(-5)), "checkpoint.npz"),
    "an array of steps": (lambda run: changed(run, step=np.arange(3)), "checkpoint.npz"),
    "a broken config in it": (lambda run: changed(run, config=np.array('{"a" 1}')), "checkpoint.npz"),
    "another optimiser's state": (lambda run: changed(run, **{"state/latent": np.zeros(7)}), "checkpoint.npz"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_one_error_names_the_file(tmp_path, name):
    damage, file = DAMAGES[name]
    write_run(tmp_path)
    read_run(tmp_path)
    damage(tmp_path / "run")
    before = contents(tmp_path / "run")
    with pytest.raises(ValueError) as caught:
        read_run(tmp_path)
    assert str(tmp_path / "run" / file) in str(caught.value), caught.value
    assert "\n" not in str(caught.value)
    assert contents(tmp_path / "run") == before, "nothing is lost"
