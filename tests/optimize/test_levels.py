"""From coarse to fine: when the next level begins, what it changes, and that a run resumes in the middle of one."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.optimize import phase, shape
from jaxdr.optimize.config import Level, OptimizeConfig, Optimizer, Remesh, Target
from jaxdr.optimize.preconditioner import LargeSteps
from jaxdr.optimize.problem import OBJECT, build_problem
from jaxdr.optimize.progress import Interrupted, NotFinite
from jaxdr.optimize.shape import optimize
from jaxdr.optimize.signal import signal_to_noise

from .fake import render as fake_render
from .test_loop import checkpoint, press_ctrl_c_after, rows, small_config, with_optimizer

LEVELS = (Level(resolution=8, image=1, gradient=1, views_per_step=1), Level(gradient=2), Level(edge_length=0.15))


@pytest.fixture(autouse=True)
def seen(monkeypatch):
    """Sizes and samples of all images that were traced."""
    traced = []

    @functools.wraps(fake_render)
    def render(scene, key, spp, integrator):
        traced.append((scene.camera.film.width, spp))
        return fake_render(scene, key, spp, integrator)

    monkeypatch.setattr(phase, "render", render)
    return traced


def config(path, levels=LEVELS, **changes):
    made = with_optimizer(small_config(path), iterations=12, **changes)
    return dataclasses.replace(made, levels=levels)


def columns(of, *names):
    return [tuple(row[name] for name in names) for row in rows(of)]


def test_every_level_has_its_own_numbers(tmp_path, seen, capsys):
    pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install -e ".[remesh]"')
    made = config(tmp_path / "run", signal_to_noise=1e9)  # never enough: a level ends as soon as it may
    optimize(made)
    # A round of three views: one view a step in the first level, two in the others.
    assert [level for (level,) in columns(made, "level")] == ["0"] * 3 + ["1"] * 2 + ["2"] * 7
    counts = [int(n) for (n,) in columns(made, "vertices")]
    assert set(counts[:5]) == {162} and set(counts[5:]) == {counts[-1]} != {162}
    assert {(8, 1), (16, 4), (16, 2)} <= set(seen)  # images and gradients
    assert (8, 4) in seen  # pictures are of the level, too; targets are means of them
    told = capsys.readouterr().err
    assert "after step 3: signal to noise" in told and "level 2 of 3: 16 pixels, 2 spp, 2 views a step" in told
    assert {path.name for path in (tmp_path / "run").glob("targets*")} == {
        "targets_0.npy",
        "targets_1.npy",
        "targets.npy",
    }


def test_the_next_level_is_compiled_before_it_begins(tmp_path, seen, monkeypatch):
    """Nothing is traced in a step, where the numbers of vertices are known: the first level's program is there too."""
    pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install -e ".[remesh]"')
    levels = (Level(resolution=8, image=1, gradient=1), Level(gradient=2), Level(vertices=300, gradient=3))
    made = config(tmp_path / "run", levels, signal_to_noise=1e9)
    made = dataclasses.replace(made, report=dataclasses.replace(made.report, pictures=12))
    original, traced = shape.ShapeTask.step, []

    def step(self, current, done, say):
        self.compiled.result()
        if current.phase.level + 1 < len(levels):
            self.coming.result()
        count = len(seen)
        result = original(self, current, done, say)
        traced.append(len(seen) - count)
        return result

    monkeypatch.setattr(shape.ShapeTask, "step", step)
    optimize(made)
    assert columns(made, "level", "vertices")[-1] == ("2", "300")
    assert not any(traced)


def test_levels_with_the_same_samples_share_a_program(tmp_path, seen):
    """More views a step, and meshes of as many vertices: nothing is traced again, and targets are rendered once."""
    pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install -e ".[remesh]"')
    levels = (Level(views_per_step=1), Level(views_per_step=2))
    made = config(tmp_path / "run", levels, signal_to_noise=1e9, remesh=(Remesh(2, vertices=162, every=3, until=9),))
    optimize(made)
    assert columns(made, "level", "vertices")[-1] == ("1", "162")
    assert seen == [(16, 4)] * 3  # pictures, of which targets are means; image and derivative of the gradient
    np.testing.assert_array_equal(np.load(tmp_path / "run/targets_0.npy"), np.load(tmp_path / "run/targets.npy"))
    assert int(checkpoint(made)["start"]) == 8 and int(checkpoint(made)["since"]) == 3


def test_precision_is_that_of_the_caller(tmp_path, monkeypatch):
    """Of a thread's own, as `jax.enable_x64` has it: what is prepared in another thread has it as well."""
    original, dtypes = phase.render, set()

    def render(scene, key, spp, integrator):
        dtypes.add(str(scene.parameters()[f"{OBJECT}.vertices"].dtype))
        return original(scene, key, spp, integrator)

    monkeypatch.setattr(phase, "render", render)
    with jax.enable_x64(True):
        optimize(config(tmp_path / "run", levels=(Level(resolution=8), Level()), signal_to_noise=1e9))
    assert dtypes == {"float64"}


def test_a_failure_beside_the_run_ends_it(tmp_path, monkeypatch):
    original = phase.render

    def render(scene, key, spp, integrator):
        image = original(scene, key, spp, integrator)
        return image if scene.camera.film.width == 8 else image * jnp.nan

    monkeypatch.setattr(phase, "render", render)
    made = config(tmp_path / "run", levels=(Level(resolution=8), Level()), signal_to_noise=1e9)
    with pytest.raises(NotFinite, match="the target image of view 0 is not finite"):
        optimize(made)


def test_a_level_goes_on_while_there_is_signal(tmp_path):
    made = config(tmp_path / "run", levels=(Level(resolution=8), Level()), signal_to_noise=1e-9, learning_rate=1e-5)
    optimize(made)
    ratios = [ratio for (ratio,) in columns(made, "signal_to_noise")]
    assert [i for i, ratio in enumerate(ratios) if ratio] == list(range(1, 12, 2))  # the last steps of rounds
    assert min(float(ratio) for ratio in ratios if ratio) > 1  # far from the target: little but signal
    assert {level for (level,) in columns(made, "level")} == {"0"}


def test_the_last_level_is_not_asked(tmp_path):
    made = with_optimizer(small_config(tmp_path / "run"), iterations=6)
    optimize(made)
    assert {ratio for (ratio,) in columns(made, "signal_to_noise")} == {""}


def test_the_optimiser_goes_on_where_the_topology_does(tmp_path):
    made = config(tmp_path / "run", levels=(Level(resolution=8), Level()), signal_to_noise=1e9)
    optimize(made)
    assert int(checkpoint(made)["state/optimizer/0/count"]) == 12 and int(checkpoint(made)["level"]) == 1
    assert checkpoint(made)["start"] == 0 and checkpoint(made)["since"] == 2


def test_another_preconditioner_starts_afresh_from_the_shape_as_it_is(tmp_path, monkeypatch):
    made = config(tmp_path / "run", levels=(Level(), Level(lam=0.5)), signal_to_noise=1e9)
    original, vertices = shape.ShapeTask.next_level, []

    def next_level(self, phase, state, *arguments):
        phases = (phase, state), original(self, phase, state, *arguments)
        vertices.extend(np.asarray(phase.vertices(state)) for phase, state in phases)
        return phases[1]

    monkeypatch.setattr(shape.ShapeTask, "next_level", next_level)
    optimize(made)
    np.testing.assert_allclose(*vertices, atol=1e-6)
    assert int(checkpoint(made)["state/optimizer/0/count"]) == 10 and int(checkpoint(made)["start"]) == 2


def test_noise_is_that_of_the_step(tmp_path, monkeypatch):
    """The two estimates share views and vertices, and nothing else; the step goes along their mean."""
    calls, moves = [], []
    original = phase.make_phase

    def spied(*arguments):
        made = original(*arguments)

        def gradients(vertices, views):
            found = made.gradients(vertices, views)
            for (pose, _, key), (_, gradient) in zip(views, found, strict=True):
                calls.append((np.asarray(pose), jax.random.key_data(key).tolist(), np.asarray(gradient)))
            return found

        def update(state, gradient):
            moves.append(np.asarray(gradient))
            return made.update(state, gradient)

        return made._replace(gradients=gradients, update=update)

    monkeypatch.setattr(shape, "make_phase", spied)
    made = config(tmp_path / "run", levels=(Level(), Level()))
    made = dataclasses.replace(made, optimizer=dataclasses.replace(made.optimizer, iterations=2))
    optimize(made)
    assert len(calls) == 2 + 4
    first, second = calls[2:4], calls[4:6]
    for (pose, key, gradient), (pose_again, key_again, gradient_again) in zip(first, second, strict=True):
        np.testing.assert_array_equal(pose, pose_again)
        assert key != key_again and not np.array_equal(gradient, gradient_again)
    a, b = (np.mean([gradient for *_, gradient in part], axis=0) for part in (first, second))
    np.testing.assert_allclose(moves[1], (a + b) / 2, rtol=1e-6)
    steps = LargeSteps(build_problem(made).scene.shapes[OBJECT].mesh, made.optimizer.lam)
    (ratio,) = [float(ratio) for (ratio,) in columns(made, "signal_to_noise") if ratio]
    expected = signal_to_noise(*(steps.from_latent(jnp.asarray(g, jnp.float32)) for g in (a, b)))
    assert ratio == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("size", [Level(edge_length=0.15), Level(vertices=200), Level(lam=3.0)])
def test_interrupted_as_a_level_begins_and_resumed(tmp_path, monkeypatch, size):
    pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install -e ".[remesh]"')
    levels = (LEVELS[0], size)
    straight, stopped = (config(tmp_path / name, levels, signal_to_noise=1e9) for name in ("straight", "stopped"))
    straight, stopped = (with_optimizer(made, iterations=5) for made in (straight, stopped))
    optimize(straight)
    for steps in (2, 3):  # in the first level, and with the checkpoint in which the second one begins
        with monkeypatch.context() as patch:
            press_ctrl_c_after(patch, steps)
            with pytest.raises(Interrupted):
                optimize(stopped, resume=steps > 2)
    optimize(stopped, resume=True)
    for name, value in checkpoint(straight).items():
        np.testing.assert_array_equal(value, checkpoint(stopped)[name], err_msg=name)
    timeless = [[{**row, "seconds": ""} for row in rows(c)] for c in (straight, stopped)]
    assert timeless[0] == timeless[1]


def test_gpytoolbox_is_asked_for_before_the_start(tmp_path, monkeypatch):
    def missing():
        raise ImportError('pip install -e ".[remesh]"')

    monkeypatch.setattr(shape, "require_gpytoolbox", missing)
    with pytest.raises(ImportError):
        optimize(config(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"levels": (Level(resolution=8),)},
            r"levels: resolutions must not fall, and end with cameras\.resolution",
        ),
        ({"levels": (Level(96), Level(48), Level())}, "resolutions must not fall"),
        (
            {"levels": (Level(48, edge_length=0.1), Level())},
            r"levels\[0\]\.edge_length: the first level has",
        ),
        (
            {"levels": (Level(48, vertices=100), Level())},
            r"levels\[0\]\.vertices: the first level has",
        ),
        ({"levels": (Level(48, views_per_step=9), Level())}, r"levels\[0\]\.views_per_step: must not exceed"),
        (
            {"levels": (Level(48), Level(vertices=99)), "optimizer": Optimizer(remesh=(Remesh(3, 0.1),))},
            r"optimizer\.remesh: levels that remesh are there already",
        ),
    ],
)
def test_levels_that_make_no_sense(changes, message):
    with pytest.raises(ValueError, match=message):
        OptimizeConfig(output="run", target=Target(shape="sphere"), **changes)


def test_negative_numbers():
    with pytest.raises(ValueError, match="gradient: must not be negative, got -1"):
        Level(gradient=-1)
