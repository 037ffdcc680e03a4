"""The scripts of examples/: short, explained, and run as a reader runs them, in a process and a folder of their own."""

import json
import math
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from examples import take_photographs
from examples.your_own_bsdf import Minnaert
from jaxdr.optimize.reconstruction.config import reconstruct_config
from jaxdr.optimize.reconstruction.reconstruct import reconstruct
from jaxdr.program_cache import SIZE, user_folder

ROOT = Path(__file__).resolve().parents[1]
MOST_LINES = 67
SCRIPTS = sorted(path.stem for path in (ROOT / "examples").glob("*.py") if "__main__" in path.read_text())


def run(script: Path, folder: Path, programs: Path) -> str:
    """What a script prints; `programs` keeps compiled ones.

    Scripts are compiled as users compile them: without the flags that make the tests' own programs fast to compile.
    """
    # The limit is that of the tests: beside programs that were kept without one, JAX keeps no others.
    kept = {"JAX_COMPILATION_CACHE_DIR": str(programs), "JAX_COMPILATION_CACHE_MAX_SIZE": str(SIZE)}
    environment = os.environ | kept | {"PYTHONPATH": str(ROOT), "XLA_FLAGS": ""}
    done = subprocess.run([sys.executable, str(script)], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text)]


@pytest.fixture
def printed(tmp_path):
    """A function that runs a script in `tmp_path`. Compiled programs are kept where those of the tests are."""
    return lambda name: run(ROOT / "examples" / f"{name}.py", tmp_path, user_folder() / "tests")


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_is_short_and_in_the_tutorials(name):
    path = ROOT / "examples" / f"{name}.py"
    assert len(path.read_text().splitlines()) <= MOST_LINES
    assert f'--8<-- "examples/{name}.py"' in (ROOT / "docs/tutorials.md").read_text()
    assert re.search(rf"def test_(\w+_and_)?{name}(_and_\w+)?\(", Path(__file__).read_text())


def test_many_devices(printed, tmp_path):
    """The gradient is that of one device. Rounding differs between machines, so both are computed here."""
    one = tmp_path / "one_device.py"
    script = (ROOT / "examples/many_devices.py").read_text()
    one.write_text(script.replace('"jax_num_cpu_devices", 2', '"jax_num_cpu_devices", 1'))
    expected, found = (text.splitlines()[-1] for text in (run(one, tmp_path, tmp_path), printed("many_devices")))
    assert expected.startswith("1 devices") and found.startswith("2 devices")
    np.testing.assert_allclose(numbers(found), numbers(expected), rtol=0.01)


def test_export_to_blender(printed, tmp_path):
    assert "vertices: 2562 faces: 5120 closed: True" in printed("export_to_blender")
    # As the file stands: y up, 4 bytes a number; the header is JSON.
    data = (tmp_path / "duck.glb").read_bytes()
    header = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    low, high = next((a["min"], a["max"]) for a in header["accessors"] if a["type"] == "VEC3" and "min" in a)
    duck = np.asarray(jd.shapes.duck(4).vertices)
    np.testing.assert_allclose([low[1], high[1]], [duck[:, 2].min(), duck[:, 2].max()], atol=1e-6)


def test_your_own_bsdf(printed, tmp_path):
    assert numbers(printed("your_own_bsdf"))[0] < 0  # a darker rim
    assert (tmp_path / "moon.png").stat().st_size > 500


@pytest.mark.parametrize("k", [1.0, 1.5, 3.0])
def test_the_bsdf_of_the_tutorial_scatters_what_its_formula_says(k):
    model, cos_i = Minnaert(0.6, k), 0.7
    u = jax.random.uniform(jax.random.key(0), (1 << 16, 2))
    wi = jnp.broadcast_to(jnp.array([math.sqrt(1 - cos_i**2), 0.0, cos_i]), (len(u), 3))
    wo = model.sample(wi, u)
    albedo = (model.eval(wi, wo)[:, 0] / model.pdf(wi, wo)).mean()
    exact = 0.6 * cos_i ** (k - 1)  # the integral of (k + 1) / (2 pi) cos_o^k is one
    np.testing.assert_allclose(albedo, exact, rtol=0.01)
    there, back = model.eval(wi, wo)[:, 0] / wo[:, 2], model.eval(wo, wi)[:, 0] / cos_i
    above = wo[:, 2] > 1e-3
    np.testing.assert_allclose(there[above], back[above], rtol=1e-3)


@pytest.mark.slow
def test_albedo_and_light(printed):
    found = numbers(printed("albedo_and_light"))
    np.testing.assert_allclose(found, [0.7, 0.3, 0.1, 24.0, 20.0, 14.0], rtol=0.08)


@pytest.mark.slow
def test_first_gradient(printed, tmp_path):
    assert 0.03 < numbers(printed("first_gradient"))[0] < 0.12
    derivative = jd.load_image(tmp_path / "derivative.png")
    assert derivative[..., 0].max() > 0.3 and derivative[..., 2].max() > 0.3
    assert derivative[-10:, :30].max() < derivative.max()


@pytest.mark.slow
def test_compare_with_finite_differences(printed):
    ratio, error = numbers(printed("compare_with_finite_differences"))[-2:]
    assert abs(ratio - 1) < 4 * error < 0.25


@pytest.mark.slow
def test_optimise_a_pose(printed):
    errors = numbers(printed("optimise_a_pose"))[1::2]
    assert errors[0] > 0.4 and errors[-1] < 0.05


@pytest.mark.slow
def test_levenberg_marquardt(printed):
    found = numbers(printed("levenberg_marquardt"))
    np.testing.assert_allclose(found[:3], found[3:], atol=0.03)


@pytest.mark.slow
def test_mesh_from_views(printed, tmp_path):
    before, after = numbers(printed("mesh_from_views"))
    assert after < before / 4
    assert jd.load_mesh(tmp_path / "figure.glb").closed


@pytest.mark.slow
def test_torch_optimiser(printed):
    pytest.importorskip("torch", reason='PyTorch is not installed: pip install -e ".[torch]"')
    found = numbers(printed("torch_optimiser").splitlines()[-1])
    np.testing.assert_allclose(found, [0.4, 0.1, 0.2, 0.8, 0.4, 0.1], atol=0.06)


@pytest.mark.slow
def test_take_photographs_and_from_photographs(printed, tmp_path):
    printed("take_photographs")
    before, after = numbers(printed("from_photographs"))
    assert after > 21 and after > before + 6  # dB; masks cut pixels out as with scissors
    assert jd.load_mesh(tmp_path / "found.glb").closed


@pytest.mark.slow
def test_the_main_job_of_the_readme(tmp_path):
    take_photographs.main(str(tmp_path / "photographs"))
    table = tomllib.loads((ROOT / "configs/photographs.toml").read_text())
    summary = reconstruct(reconstruct_config(table, "README", str(tmp_path / "photographs"), str(tmp_path / "cow")))
    assert summary["psnr"]["worst"] > 25 and summary["iou"]["worst"] > 0.95
    assert {"asset.glb", "report.html", "turntable.gif"} <= {path.name for path in (tmp_path / "cow").iterdir()}


def test_its_config_is_valid(tmp_path):
    table = tomllib.loads((ROOT / "configs/photographs.toml").read_text())
    assert reconstruct_config(table, "README", "photographs", str(tmp_path)).steps == 160


def test_the_photographs_of_the_tutorial_are_read(tmp_path):
    take_photographs.main(str(tmp_path), count=3, pixels=8, samples=1)
    views = jd.load_views(tmp_path).views
    assert len(views) == 3 and all(0.05 < view.alpha.mean() < 0.6 for view in views)
    poses = [view.to_world for view in views]
    np.testing.assert_allclose(poses, take_photographs.poses(3), atol=1e-6)
