"""A wheel of the package, built, installed into a fresh environment, and used outside of the checkout."""

import os
import re
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DATA = (".csv", ".npz", ".css", ".js", ".txt", ".h", ".typed")


def call(*command: object, cwd: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([str(word) for word in command], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_wheel_runs_the_example_of_the_readme_and_the_quickstart(tmp_path):
    call(sys.executable, "-m", "build", "--outdir", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("jaxdr-*.whl")
    inside = zipfile.ZipFile(wheel).namelist()
    data = {path.relative_to(ROOT).as_posix() for path in (ROOT / "jaxdr").rglob("*") if path.suffix in DATA}
    assert data and data <= set(inside)
    assert {name.split("/")[0].split("-")[0] for name in inside} == {"jaxdr"}
    assert list(tmp_path.glob("jaxdr-*.tar.gz"))

    venv.create(tmp_path / "environment", with_pip=True)
    programs = tmp_path / "environment" / ("Scripts" if os.name == "nt" else "bin")
    call(programs / "python", "-m", "pip", "install", "--quiet", wheel, cwd=tmp_path)
    where = call(programs / "python", "-c", "import jaxdr; print(jaxdr.__file__)", cwd=tmp_path)
    assert Path(where.strip()).is_relative_to(tmp_path)

    example = re.search(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE)
    (tmp_path / "example.py").write_text(example.group(1))
    gradient = call(programs / "python", "example.py", cwd=tmp_path).strip().splitlines()[-1]
    assert re.fullmatch(r"\[ *-?\d\S*( +-?\d\S*){2}\]", gradient), gradient
    assert "optimize" in call(programs / "jaxdr", "--help", cwd=tmp_path)

    config = ROOT / "configs/quickstart.toml"
    few = ["--set", "optimizer.iterations=2", "--set", "output=quickstart"]
    call(programs / "jaxdr", "optimize", config, *few, cwd=tmp_path)
    assert (tmp_path / "quickstart/meshes").is_dir() and (tmp_path / "quickstart/metrics.json").is_file()
    call(programs / "jaxdr", "view", "quickstart", cwd=tmp_path)
    assert "model-viewer" in (tmp_path / "quickstart/view.html").read_text()
