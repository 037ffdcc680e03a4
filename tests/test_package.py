"""The package as an installer and a reader of the repository see it."""

import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import jaxdr
from tests.test_documentation import public_names

ROOT = Path(__file__).resolve().parents[1]


def tracked_files():
    """Files under version control, or every file where there is none (an unpacked archive)."""
    answer = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if answer.returncode == 0:
        return [ROOT / name for name in answer.stdout.split("\0") if name]
    hidden = {".git", ".venv", "runs", "__pycache__"}
    return [p for p in ROOT.rglob("*") if p.is_file() and not hidden.intersection(p.relative_to(ROOT).parts)]


def test_version_is_that_of_the_distribution():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert jaxdr.__version__ == declared == importlib.metadata.version("jaxdr")


@pytest.mark.parametrize(
    "name",
    "Mesh Scene Shape Perspective Film Gaussian Box Tent Diffuse TwoSided AreaEmitter ConstantEnvironment load_mesh "
    "load_mitsuba load_gltf load_image write_image look_at render PathTracer KernelDensity LineSampling WarpedArea "
    "RednerWAS LargeSteps adam_uniform remesh chamfer losses".split(),
)
def test_name_of_the_contract_is_public_and_documented(name):
    assert (getattr(jaxdr, name).__doc__ or "").strip()


def test_completion_shows_public_names_only():
    import jaxdr.atomic_file  # a module of our own, which is an attribute now

    assert dir(jaxdr) == sorted([*public_names(), "__version__"])


def test_importing_leaves_the_configuration_of_jax_alone():
    program = (
        "import jax; before = dict(jax.config.values); import jaxdr; after = dict(jax.config.values);"
        "changed = [k for k in before if before[k] != after.get(k)]; assert not changed, changed"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_no_machine_paths_in_tracked_files():
    machine_path = re.compile(rb"(?<![\w.])/(work|root|home/\w+|Users/\w+|tmp/\w+)/")
    assert [p.relative_to(ROOT).as_posix() for p in tracked_files() if machine_path.search(p.read_bytes())] == []


def test_readme_and_ci_run_the_same_test_command():
    command = (ROOT / ".ci/run").read_text().strip().splitlines()[-1]
    assert "pytest" in command
    assert command in (ROOT / "README.md").read_text().splitlines()
