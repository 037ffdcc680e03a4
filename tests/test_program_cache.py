"""Compiled programs of commands are kept: where, what is said, and what a second process makes of them."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from jaxdr import cli, program_cache

from .test_cli import SCENE

ROOT = Path(cli.__file__).parents[1]


@pytest.fixture
def settings(monkeypatch):
    """Stand-in for JAX's settings, with no folder set: a dictionary of what is changed."""
    changed = {}
    config = SimpleNamespace(jax_compilation_cache_dir=None, update=changed.__setitem__)
    monkeypatch.setattr(program_cache, "jax", SimpleNamespace(config=config))
    return changed


@pytest.mark.parametrize(
    "platform, environment, folder",
    [
        ("linux", {}, Path.home() / ".cache" / "jaxdr"),
        ("linux", {"XDG_CACHE_HOME": "/caches"}, Path("/caches/jaxdr")),
        ("darwin", {"XDG_CACHE_HOME": "/caches"}, Path.home() / "Library" / "Caches" / "jaxdr"),
        ("win32", {"LOCALAPPDATA": "/local"}, Path("/local/jaxdr")),
        ("win32", {}, Path.home() / "AppData" / "Local" / "jaxdr"),
    ],
)
def test_folder_of_the_platform(platform, environment, folder):
    assert program_cache.user_folder(environment, platform) == folder


def run(tmp_path, *options, **environment):
    """What `jaxdr render` of a small scene says, in a process of its own, and the image."""
    (tmp_path / "scene.xml").write_text(SCENE)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("JAX_COMPILATION_CACHE")}
    command = [sys.executable, "-m", "jaxdr", "render", str(tmp_path / "scene.xml"), "-o", str(tmp_path / "out.npy")]
    done = subprocess.run(
        [*command, "--spp", "2", "--max-depth", "2", *options],
        capture_output=True,
        text=True,
        cwd=ROOT,
        # A fast machine compiles these in less than the second from which on JAX keeps a program.
        env=kept | {"JAX_LOGGING_LEVEL": "ERROR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"} | environment,
    )
    assert done.returncode == 0, done.stderr
    return done.stderr, np.load(tmp_path / "out.npy")


def programs(folder):
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("*-cache")}


def test_a_second_process_uses_the_programs_of_the_first(tmp_path):
    caches = {"XDG_CACHE_HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path), "HOME": str(tmp_path)}
    said, first = run(tmp_path, **caches)
    folder = program_cache.user_folder(caches) / "programs"
    assert said.count("jaxdr: compiled programs are kept in ") == 1
    assert f"{folder} (--no-cache leaves that out)" in said
    kept = programs(folder)
    assert kept
    _, second = run(tmp_path, **caches)
    assert programs(folder) == kept
    np.testing.assert_array_equal(first, second)


def test_a_program_that_was_written_in_part_is_deleted(settings, tmp_path):
    """JAX looks up the last use of every program before it keeps another, and fails where one has none."""
    for name in ("whole-cache", "whole-atime", "part-cache"):
        (tmp_path / name).write_bytes(bytes(8))
    program_cache.keep_programs(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} - {".lockfile"} == {"whole-cache", "whole-atime"}


def test_left_out(settings, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cli.main(["render", "nothing.xml", "-o", "out.png", "--no-cache"])
    assert settings == {"jax_enable_compilation_cache": False}
    assert "programs" not in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_folder_that_jax_was_told_of(settings, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(program_cache.jax.config, "jax_compilation_cache_dir", str(tmp_path / "mine"))
    cli.main(["render", "nothing.xml", "-o", "out.png"])
    assert settings == {}
    assert f"programs are kept in {tmp_path / 'mine'} " in capsys.readouterr().err


def test_a_folder_that_cannot_be_made(settings, capsys, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(cli, "user_folder", lambda: tmp_path / "file")
    cli.main(["render", "nothing.xml", "-o", "out.png"])
    assert settings == {}
    lines = capsys.readouterr().err.splitlines()
    assert sum("jaxdr: warning: compiled programs are not kept: " in line for line in lines) == 1


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_that_is_read_only(settings, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OSError):
        program_cache.keep_programs(tmp_path)
