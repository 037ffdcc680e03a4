"""Configs of recoveries: what is accepted, and one clear line for everything that isn't."""

import numpy as np
import pytest

from jaxdr.images import write_image
from jaxdr.optimize.recovery.config import Adam, LevenbergMarquardt, is_recovery, recovery_config
from jaxdr.optimize.recovery.problem import build_problem
from jaxdr.optimize.strict_toml import read_toml

HEAD = 'output = "runs/x"\n[scene]\nname = "still_life"\noptions = { resolution = 8 }\n'
LIGHT = '[[parameters]]\nname = "lamp.position"\n'
LEAST_SQUARES = '[optimizer]\nkind = "levenberg_marquardt"\n'


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "run.toml"
        path.write_text(text)
        table = read_toml(path)
        assert is_recovery(table)
        return recovery_config(table, path)

    return read


def test_defaults_and_values(read):
    config = read(HEAD + LIGHT + "initial = [1, 2, 3]\n" + LEAST_SQUARES + "blur = [2, 0]\n")
    assert isinstance(config.optimizer, LevenbergMarquardt) and config.optimizer.blur == (2.0, 0.0)
    assert config.optimizer.iterations < 30
    assert config.parameters[0].initial == (1.0, 2.0, 3.0)
    assert isinstance(read(HEAD + LIGHT + "learning_rate = 0.1\n").optimizer, Adam)
    assert isinstance(read(HEAD + LIGHT + "learning_rate = 0.1\n[optimizer]\niterations = 3\n").optimizer, Adam)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, r"parameters: missing; expected a list of tables"),
        (HEAD + "parameters = 3", r"parameters"),
        ('output = "x"\n' + LIGHT, r"scene: missing; expected a table"),
        ('output = "x"\n[scene]\n' + LIGHT, r"scene\.name: give either a name or a file"),
        ('output = "x"\n[scene]\nname = "stil_life"\n' + LIGHT, r"scene\.name: expected one of textured_object, "),
        (
            'output = "x"\n[scene]\nname = "still_life"\noptions = { size = 1 }\n' + LIGHT,
            r"scene\.options\.size: still_life has no such option \(known: resolution, light\)",
        ),
        (
            'output = "x"\n[scene]\nfile = "a.xml"\n' + LIGHT + LEAST_SQUARES,
            r"scene\.file: expected a file, found none at .*a\.xml",
        ),
        (HEAD + LIGHT, r"parameters\[0\]\.learning_rate: Adam needs a number"),
        (HEAD + LIGHT + "learning_rate = 0\n", r"parameters\[0\]\.learning_rate: must be positive, got 0"),
        (HEAD + LIGHT + "learnin_rate = 1\n", r"parameters\[0\]\.learnin_rate: unknown key; did you mean"),
        (
            HEAD + LIGHT + "learning_rate = 1\n" + LEAST_SQUARES,
            r"parameters\[0\]\.learning_rate: Levenberg-Marquardt takes none, got 1",
        ),
        (HEAD + 2 * LIGHT + LEAST_SQUARES, r"parameters\[1\]\.name: must not be named twice, got 'lamp\.position'"),
        (HEAD + LIGHT + 'motion = "rigid"\n' + LEAST_SQUARES, r"parameters\[0\]\.motion: is for vertices and to_world"),
        (HEAD + LIGHT + "smoothing = 3\n" + LEAST_SQUARES, r"parameters\[0\]\.smoothing: is for vertices"),
        (
            HEAD + '[[parameters]]\nname = "camera.to_world"\ninitial = [1, 2, 3]\n' + LEAST_SQUARES,
            r"parameters\[0\]\.initial: rigid takes 6 numbers \(degrees, then units\), got",
        ),
        (
            HEAD + '[[parameters]]\nname = "box.vertices"\ninitial = 3\nlearning_rate = 1\n',
            r"parameters\[0\]\.motion: needed for bounds or initial of vertices",
        ),
        (
            HEAD + LIGHT + '[optimizer]\nkind = "lm"\n',
            r"optimizer\.kind: expected one of 'adam', 'levenberg_marquardt', got 'lm'",
        ),
        (HEAD + LIGHT + LEAST_SQUARES + "views_per_step = 1\n", r"optimizer\.views_per_step: unknown key"),
        (HEAD + LIGHT + LEAST_SQUARES + "blur = []\n", r"optimizer\.blur: must be a list of numbers from zero on"),
        (
            HEAD + LIGHT + LEAST_SQUARES + "iterations = 3\nblur = [2, 0]\n",
            r"optimizer\.iterations: must be at least 4, two for each blur, got 3",
        ),
        (
            HEAD + LIGHT + "learning_rate = 1\n[optimizer]\nviews_per_step = 2\n",
            r"optimizer\.views_per_step: must not exceed the number of views, 1, got 2",
        ),
        (
            HEAD + '[[parameters]]\nname = "camera.to_world"\n[cameras]\nviews = 2\n' + LEAST_SQUARES,
            r"cameras: give the views, so camera\.to_world can't be a parameter",
        ),
        (
            HEAD + LIGHT + LEAST_SQUARES + '[target]\nimages = ["a.npy"]\n',
            r"target\.images\[0\]: expected a file, found none at .*a\.npy",
        ),
        (
            HEAD + LIGHT + LEAST_SQUARES + '[target]\nname = "still_life"\nimages = ["a.npy"]\n',
            r"target\.name: give at most one of name, file and images",
        ),
    ],
)
def test_mistakes_in_the_file(read, text, message):
    with pytest.raises(ValueError, match=rf"run\.toml: {message}"):
        read(text)


def parameter(name, more=""):
    return f'{HEAD}[[parameters]]\nname = "{name}"\nlearning_rate = 1\n{more}'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            parameter("lamp.positon"),
            r"^parameters\[0\]\.name: unknown parameter 'lamp\.positon'; did you mean 'lamp\.position'\? "
            r"\(known: .*ball\.vertices, .*camera\.to_world.*lamp\.intensity",
        ),
        (parameter("lamp.position", "initial = [1, 2]\n"), r"parameters\[0\]\.initial: expected one number or a list"),
        (
            parameter("box.bsdf.reflectance", "bounds = [0.3, 1]\n"),
            r"parameters\[0\]\.initial: must lie strictly between the bounds 0\.3 and 1, is 0\.25 to 0\.55",
        ),
        (
            parameter("lamp.position") + "[target]\noptions = { resolution = 9 }\n",
            r"target: its images have \(9, 9\) pixels, those of the scene \(8, 8\)",
        ),
    ],
)
def test_mistakes_that_show_in_the_scene(read, text, message):
    with pytest.raises(ValueError, match=message):
        build_problem(read(text))


def test_images_as_targets(read, tmp_path):
    write_image(tmp_path / "photo.npy", np.full((8, 8, 3), 0.25, np.float32))
    problem = build_problem(read(parameter("lamp.position") + '[target]\nimages = ["photo.npy"]\n'))
    assert problem.target is None and problem.images.shape == (1, 8, 8, 3) and (problem.images == 0.25).all()
    write_image(tmp_path / "photo.npy", np.full((8, 9, 3), 0.25, np.float32))
    with pytest.raises(ValueError, match=r"target\.images\[0\]: .* is 9 x 8 pixels with 3 channels, expected 8 x 8"):
        build_problem(read(parameter("lamp.position") + '[target]\nimages = ["photo.npy"]\n'))


def test_start_is_the_initial_value_and_target_the_scenes_own(read):
    text = (
        parameter("lamp.position", "initial = [1, 2, 3]\n")
        + parameter("camera.to_world", "initial = [0, 0, 9, 1, 0, 0]\n")[len(HEAD) :]
    )
    problem = build_problem(read(text))
    values = problem.values(problem.start())
    np.testing.assert_allclose(values["lamp.position"], (1, 2, 3))
    own = problem.target.parameters()
    np.testing.assert_allclose(own["lamp.position"], (1.2, -1.0, 1.8), rtol=1e-6)
    moved = np.asarray(values["camera.to_world"] - own["camera.to_world"])[:3, 3]
    np.testing.assert_allclose(moved, (1, 0, 0), atol=1e-6)
    assert not problem.fixed_views
