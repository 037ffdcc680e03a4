"""The script for a machine with a GPU says so where there is none."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / "experiments/gpu/first_run.sh"


def run(*options, folder):
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    command = ["bash", SCRIPT, "--out", folder / "out", *options]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300)


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
@pytest.mark.skipif(jax.default_backend() == "gpu", reason="there is a GPU: the script would run")
def test_without_a_gpu_it_says_so(tmp_path):
    done = run(folder=tmp_path)
    assert done.returncode == 2
    assert done.stdout == "first_run: JAX finds no device of platform cuda, so nothing was run\n"
    assert done.stderr == "" and not (tmp_path / "out").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
def test_an_unknown_option(tmp_path):
    done = run("--size", "3", folder=tmp_path)
    assert done.returncode == 1 and "unknown option --size; it takes --out" in done.stderr
