"""Configs of charts: what is accepted, and one clear line with exit code 2 for everything that isn't."""

from pathlib import Path

import numpy as np
import pytest

from jaxdr import cli
from jaxdr.chart.config import chart_config
from jaxdr.chart.scenes import load_case, nudged, view_of_config
from jaxdr.optimize.strict_toml import read_toml

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
MINIMAL = """output = "out"
samples = [1, 4]
[[scenes]]
name = "ball"
procedural = "ball_and_shadow"
options = { resolution = 8, subdivisions = 1 }
motion = { shape = "ball" }
reference = { kind = "finite_differences", step = 0.02 }
[[estimators]]
boundary = "LineSampling"
[[estimators]]
boundary = "KernelDensity"
options = { radius = 0.1 }
"""


@pytest.fixture(autouse=True)
def workplace(tmp_path, monkeypatch):
    (tmp_path / "chart.toml").write_text(MINIMAL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "_keep_programs", lambda options: None)  # tests/test_program_cache.py
    return tmp_path


def read(*overrides):
    path = Path("chart.toml")
    return chart_config(read_toml(path, overrides), path)


def test_defaults_and_names():
    config = read("keys=8", "estimators=[{boundary='WarpedArea', integrator='bdpt'}, {boundary='none', samples=[2]}]")
    assert config.keys == 8 and config.samples == (1, 4) and config.scenes[0].max_depth == 2
    assert [e.name for e in config.estimators] == ["bdpt WarpedArea", "none"]
    assert config.estimators[0].build(5).max_depth == 5
    assert [e.name for e in read().estimators] == ["LineSampling", "KernelDensity, radius=0.1"]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("kees=3", "kees: unknown key; did you mean 'keys'?"),
        ("keys=3", "multiple of positions = 4"),
        ("samples=[4, 1]", "samples: must be increasing"),
        ("estimators=[{boundary='LinSampling'}]", "boundary: expected one of AllSilhouettes, ByKind, GuidedEdges"),
        ("estimators=[{boundary='none', options={radius=1}}]", "estimators[0].options.radius: none has no such option"),
        ("estimators=[{boundary='none'}, {boundary='none'}]", "must differ, got ['none']"),
        ("estimators=[{boundary='none', integrator_options={max_depth=3}}]", "is set by the scene's max_depth"),
        ("estimators=[{boundary='LineSampling', integrator='bdpt'}]", "estimators[0].options: BidirectionalPathTracer"),
        ("scenes=[]", "scenes: give at least one"),
        ("peers=true", "scenes[0].file: peers read Mitsuba XML files only"),
        ("vertices={reference='x', target=0.1, residual='ones'}", "vertices.target: has no meaning with residual"),
        ("vertices={reference='x', target=0.1}", "vertices.reference: expected a label among LineSampling"),
    ],
)
def test_mistakes_are_one_line(capsys, workplace, override, words):
    assert cli.main(["chart", "chart.toml", "--set", override]) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxdr: error: chart.toml: ") and error.count("\n") == 1 and words in error
    assert not (workplace / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('procedural = "ball_and_shadow"', 'procedural = "bal"', "scenes[0].procedural: expected one of ball_and"),
        ("resolution = 8", "resolutio = 8", "scenes[0].options.resolutio: ball_and_shadow has no such option"),
        ('shape = "ball"', 'shape = "ballo"', "scene ball: motion.shape: expected one of ball, floor, lamp"),
        ('shape = "ball"', 'shape = "ball", kind = "vertices"', "scenes[0].motion.vertex: kind vertices"),
        ('shape = "ball"', 'shape = "ball", kind = "vertices", vertex = 9999', "scene ball: motion.vertex: ball has"),
        ("step = 0.02", "step = 0", "scenes[0].reference.step: must be positive"),
        ('kind = "finite_differences", step = 0.02', 'file = "no.npy", noise = 0.1', "found none at no.npy"),
        ('kind = "finite_differences", step = 0.02', 'file = "small.npy", noise = 0.1', "expected floats of shape [8"),
        ('kind = "finite_differences", step = 0.02', 'file = "bad.npy", noise = 0.1', "not a readable NPY file"),
        ('kind = "finite_differences", step = 0.02', 'file = "nan.npy", noise = 0.1', "1 values are not finite"),
    ],
)
def test_mistakes_in_files_are_one_line(capsys, workplace, old, new, words):
    np.save("small.npy", np.zeros((3, 3, 3)))
    Path("bad.npy").write_text("no array")
    nan = np.zeros((8, 8, 3))
    nan[2, 3, 1] = np.nan
    np.save("nan.npy", nan)
    assert old in MINIMAL
    Path("chart.toml").write_text(MINIMAL.replace(old, new))
    assert cli.main(["chart", "chart.toml"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("jaxdr: error: ") and error.count("\n") == 1 and words in error
    assert not (workplace / "out").exists()


def test_a_folder_of_others_is_left_alone(capsys, workplace):
    (workplace / "out").mkdir()
    (workplace / "out" / "thesis.txt").write_text("all of it")
    for options, words in (([], "not the folder of a chart"), (["--resume"], "no chart to resume")):
        assert cli.main(["chart", "chart.toml", *options]) == 2
        assert words in capsys.readouterr().err
    assert (workplace / "out" / "thesis.txt").read_text() == "all of it"


@pytest.mark.parametrize("name", ["chart_quick", "chart_oracles"])
def test_configs_of_the_project(name):
    path = CONFIGS / f"{name}.toml"
    config = chart_config(read_toml(path), path)
    assert config.keys % config.positions == 0
    assert len({estimator.boundary for estimator in config.estimators}) > 1


SHAPE_RUN = """output = "x"
[target]
shape = "duck"
parameters = { subdivisions = 1 }
[cameras]
views = 4
resolution = 20
[turntable]
position = [0, -3, 0]
[integrator]
boundary = "none"
[[compare]]
label = "a"
"""


def test_a_scene_may_be_a_view_of_a_config_of_optimize(workplace):
    (workplace / "run.toml").write_text(SHAPE_RUN)
    target, start = (view_of_config("run.toml", view=1, initial=initial) for initial in (False, True))
    assert target.camera.film.width == 20 and "light_0" in target.shapes
    sizes = [len(scene.shapes["object"].mesh.vertices) for scene in (target, start)]
    assert sizes == [42, 642]
    assert view_of_config("run.toml", resolution=8).camera.film.height == 8
    with pytest.raises(ValueError, match=r"options\.view: run\.toml has 4 views, got 4"):
        view_of_config("run.toml", view=4)
    (workplace / "other.toml").write_text('output = "x"\n[scene]\nname = "still_life"\n')
    with pytest.raises(ValueError, match="expected a config that makes a mesh"):
        view_of_config("other.toml")


@pytest.mark.parametrize("motion", ["{shape='ball', kind='rotate'}", "{shape='ball', kind='vertices', vertex=3}"])
def test_motions(motion):
    text = MINIMAL.replace('{ shape = "ball" }', motion)
    Path("chart.toml").write_text(text)
    scene = read().scenes[0]
    case = load_case(scene.name, scene.file, scene.procedural, scene.options, scene.motion)
    moved = np.asarray(case.at(0.3)) - np.asarray(case.rest)
    np.testing.assert_allclose(np.asarray(case.at(0.0)), case.rest, atol=1e-6)
    if "vertex" in motion:
        np.testing.assert_allclose(moved[3], [0.3, 0, 0], atol=1e-6)
        assert not np.delete(moved, 3, 0).any()
    else:
        np.testing.assert_allclose(moved[:, 2], 0, atol=1e-6)
        middle = np.asarray(case.rest).min(0) / 2 + np.asarray(case.rest).max(0) / 2
        arm = (np.asarray(case.rest) - middle)[:, :2]
        turned = arm @ np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
        np.testing.assert_allclose(np.asarray(case.at(0.3))[:, :2] - middle[:2], turned, atol=1e-5)


def test_calls_are_never_at_the_same_place():
    """Acceleration structures are kept by content: a dozen calls in a row have vertices of their own."""
    scene = read().scenes[0]
    case = load_case(scene.name, scene.file, scene.procedural, scene.options, scene.motion)
    places = {np.asarray(case.at(np.float32(nudged(case, 0.01, n)))).tobytes() for n in range(40, 80)}
    assert len(places) == 40
    shift = np.asarray(case.at(np.float32(nudged(case, 0.0, 60)))) - np.asarray(case.rest)
    assert np.abs(shift).max() < 1e-4
