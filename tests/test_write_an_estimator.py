"""The estimator of docs/write_an_estimator.md: right, and used by name wherever those of the library are."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import jaxdr as jd
from jaxdr import cli
from jaxdr.boundary.named import estimator_class, estimator_name
from jaxdr.chart.config import chart_config
from jaxdr.optimize.config import Integrator
from jaxdr.plan.pilot import Measured, Pilot
from jaxdr.plan.report import Plan
from tests.gradients.lit_box import SCENE, check_shadow

ROOT = Path(__file__).parents[1]
FILE = ROOT / "examples" / "uniform_edges.py"
NAME = "examples/uniform_edges.py:UniformEdges"
UniformEdges = estimator_class(f"{FILE}:UniformEdges")


@pytest.fixture
def at_root(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_file_and_document():
    assert len(FILE.read_text().splitlines()) <= 80
    assert FILE.name in (ROOT / "docs" / "write_an_estimator.md").read_text()
    assert isinstance(UniformEdges(), jd.Term)


@pytest.mark.parametrize("depth", [2, 3])
def test_a_soft_shadow_moves_as_differences_say(depth):
    check_shadow(UniformEdges(points=8), depth)


XML = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0.5, -5, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film></sensor>
<shape type="cube" id="box"/>
<emitter type="constant"/></scene>"""


def test_command_line(at_root, tmp_path):
    (tmp_path / "scene.xml").write_text(XML)
    arguments = ["gradient", str(tmp_path / "scene.xml"), "--wrt", "box.rotate.z", "--boundary", NAME]
    assert cli.main([*arguments, "--spp", "1", "--max-depth", "2", "-o", str(tmp_path / "out.npy")]) == 0
    assert np.any(np.load(tmp_path / "out.npy") != 0)


CHART = """output = "%s"
samples = [1, 2]
keys = 8
memory = false
terms = 2
[[scenes]]
name = "ball"
procedural = "ball_and_shadow"
options = { resolution = 8, subdivisions = 1 }
motion = { shape = "ball" }
reference = { kind = "finite_differences", step = 0.02, samples = 4, batches = 4 }
[[estimators]]
boundary = "%s"
options = { points = 2 }
"""


def test_chart(at_root, tmp_path):
    """Named after its class, and measured like any other."""
    path = tmp_path / "chart.toml"
    path.write_text(CHART % (tmp_path / "out", NAME))
    assert cli.main(["chart", str(path)]) == 0
    written = [file for file in (tmp_path / "out").rglob("*") if file.suffix in (".csv", ".json", ".md")]
    assert any("UniformEdges, points=2" in file.read_text() for file in written), written


def test_plan(at_root, tmp_path, capsys, monkeypatch):
    """It is measured as it was asked for, and kept by a name that finds it again."""

    def pilot(self, settings):
        assert [type(integrator.boundary) for integrator, _ in settings.values()] == [UniformEdges] * len(settings)
        return {name: Measured(spp, 0.1, 1.0, {"interior": 0.5}) for name, (_, spp) in settings.items()}

    monkeypatch.setattr(Pilot, "__call__", pilot)
    found = jd.plan(SCENE, ["box.translate.x"], boundary=UniformEdges(2), max_depth=2)
    assert found.integrator.boundary == UniformEdges(2)
    table = json.loads(json.dumps(found.to_dict()))
    assert table["integrator"]["boundary"] == {"kind": NAME, "points": 2}
    assert Plan.from_dict(table) == found
    (tmp_path / "scene.xml").write_text(XML)
    arguments = ["plan", str(tmp_path / "scene.xml"), "--max-depth", "2", "--boundary", NAME, "--json"]
    assert cli.main([*arguments, "--wrt", "box.translate.x"]) == 0
    assert json.loads(capsys.readouterr().out)["integrator"]["boundary"]["kind"] == NAME


def test_optimize_config(at_root):
    assert Integrator(boundary=NAME, boundary_options={"points": 3}).build().boundary == UniformEdges(3)
    with pytest.raises(ValueError, match=r"boundary_options\.pints: .* has no such parameter \(known: points\)"):
        Integrator(boundary=NAME, boundary_options={"pints": 3})


BROKEN = {
    "no_file.py:Class": "can't import no_file.py (FileNotFoundError",
    "no.module:Class": "can't import no.module (ModuleNotFoundError",
    f"{NAME}s": "there is no class UniformEdgess in examples/uniform_edges.py",
    "jaxdr.boundary.shared.term:Chunk": "Chunk is no jaxdr.Term: it has no prepare, draw",
    "UniformEdges": "got 'UniformEdges' (or FILE.py:CLASS or MODULE:CLASS)",
}


@pytest.mark.parametrize("name", BROKEN)
def test_clear_errors(at_root, capsys, name):
    words = BROKEN[name]
    with pytest.raises(ValueError, match=re.escape(words)):
        estimator_class(name)
    assert cli.main(["gradient", "scene.xml", "--wrt", "x", "-o", "x.npy", "--boundary", name]) == 2
    message = capsys.readouterr().err
    assert words in message and message.strip().count("\n") == 0
    table = {"output": "out", "scenes": [], "estimators": [{"boundary": name}]}
    with pytest.raises(ValueError, match=r"estimators\[0\]\.boundary: ") as problem:
        chart_config(table, Path("chart.toml"))
    assert words in str(problem.value)


def test_a_file_that_fails(tmp_path):
    """Its own error is in the message, and once it is mended it can be read."""
    path = tmp_path / "mine.py"
    path.write_text("import jaxdr\n1 / 0\n")
    with pytest.raises(ValueError, match=r"can't import .*mine\.py \(ZeroDivisionError: division by zero\)"):
        estimator_class(f"{path}:Mine")
    path.write_text("class Mine:\n    name = 'boundary'\n    def prepare(self): ...\n    draw = image = prepare\n")
    found = estimator_class(f"{path}:Mine")
    assert estimator_class(f"{path}:Mine") is found and estimator_name(found) == f"{path}:Mine"
    assert estimator_name(jd.LineSampling) == "LineSampling"
    with pytest.raises(ValueError, match="no name finds the boundary estimator Local"):
        estimator_name(type("Local", (), {}))
