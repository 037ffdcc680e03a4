"""From coarse to fine: when the next level begins, what it changes, and that a run resumes in the middle of one."""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.optimize import loop, phase
from jaxdr.optimize.config import Level, OptimizeConfig, Optimizer, Remesh, Target
from jaxdr.optimize.loop import Interrupted, optimize
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
    made = with_optimizer(small_config(path), iterations=30, **changes)
    return dataclasses.replace(made, levels=levels)


def columns(of, *names):
    return [tuple(row[name] for name in names) for row in rows(of)]


def test_every_level_has_its_own_numbers(tmp_path, seen, capsys):
    pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install "jaxdr[remesh]"')
    made = config(tmp_path / "run", signal_to_noise=1e9)  # never enough: a level ends as soon as it may
    optimize(made)
    # Two rounds of three views: one view a step in the first level, two in the others.
    assert [level for (level,) in columns(made, "level")] == ["0"] * 6 + ["1"] * 4 + ["2"] * 20
    counts = [int(n) for (n,) in columns(made, "vertices")]
    assert set(counts[:10]) == {162} and set(counts[10:]) == {counts[-1]} != {162}
    assert {(8, 16), (8, 1), (16, 4), (16, 2), (16, 16)} <= set(seen)  # targets, images and gradients
    assert (8, 4) in seen  # pictures are of the level, too
    told = capsys.readouterr().err
    assert "after step 6: signal to noise" in told and "level 2 of 3: 16 pixels, 2 spp, 2 views a step" in told
    assert {path.name for path in (tmp_path / "run").glob("targets*")} == {
        "targets_0.npy",
        "targets_1.npy",
        "targets.npy",
    }


def test_a_level_goes_on_while_there_is_signal(tmp_path):
    made = config(tmp_path / "run", levels=(Level(resolution=8), Level()), signal_to_noise=1e-9, learning_rate=1e-5)
    optimize(made)
    ratios = [float(ratio) for (ratio,) in columns(made, "signal_to_noise") if ratio]
    assert min(ratios) > 1  # hardly moved: the same gradient every time, but for noise
    assert {level for (level,) in columns(made, "level")} == {"0"}


def test_the_optimiser_goes_on_where_the_topology_does(tmp_path):
    made = config(tmp_path / "run", levels=(Level(resolution=8), Level()), signal_to_noise=1e9)
    optimize(made)
    assert int(checkpoint(made)["state_1"]) == 30 and int(checkpoint(made)["level"]) == 1
    assert checkpoint(made)["start"] == 0 and checkpoint(made)["since"] == 4


def test_the_signal_is_that_of_latent_gradients(tmp_path):
    """Of one level without levels: every round of the run's own views, two views a step, three views in all."""
    made = with_optimizer(small_config(tmp_path / "run"), iterations=4)
    gradients = []

    original = phase.State._replace

    def replaced(self, **changes):
        if "signal" in changes:
            gradients.append(np.asarray(self.signal.total / self.signal.views))
        return original(self, **changes)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(phase.State, "_replace", replaced)
        optimize(made)
    (ratio,) = [float(ratio) for (ratio,) in columns(made, "signal_to_noise") if ratio]
    assert ratio == pytest.approx(signal_to_noise(*(jnp.asarray(g) for g in gradients)), rel=1e-5)


@pytest.mark.parametrize("steps", [5, 6, 8, 12])
def test_interrupted_in_any_level_and_resumed(tmp_path, monkeypatch, steps):
    pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install "jaxdr[remesh]"')
    straight, stopped = (config(tmp_path / name, signal_to_noise=1e9) for name in ("straight", "stopped"))
    optimize(straight)
    with monkeypatch.context() as patch:
        press_ctrl_c_after(patch, steps)
        with pytest.raises(Interrupted):
            optimize(stopped)
    optimize(stopped, resume=True)
    for name, value in checkpoint(straight).items():
        if name != "seconds":
            np.testing.assert_array_equal(value, checkpoint(stopped)[name], err_msg=name)
    timeless = [[{**row, "seconds": ""} for row in rows(c)] for c in (straight, stopped)]
    assert timeless[0] == timeless[1]


def test_gpytoolbox_is_asked_for_before_the_start(tmp_path, monkeypatch):
    def missing():
        raise ImportError('pip install "jaxdr[remesh]"')

    monkeypatch.setattr(loop, "require_gpytoolbox", missing)
    with pytest.raises(ImportError):
        optimize(config(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"levels": (Level(resolution=8),)},
            r"levels: resolutions must not fall, and end with cameras\.resolution = 96",
        ),
        ({"levels": (Level(96), Level(48), Level())}, "resolutions must not fall"),
        (
            {"levels": (Level(48, edge_length=0.1), Level())},
            r"levels\[0\]\.edge_length: the first level has the initial",
        ),
        ({"levels": (Level(48, views_per_step=9), Level())}, r"levels\[0\]\.views_per_step: must not exceed"),
        (
            {"levels": (Level(48), Level()), "optimizer": Optimizer(remesh=(Remesh(3, 0.1),))},
            r"optimizer\.remesh: levels have an edge_length",
        ),
    ],
)
def test_levels_that_make_no_sense(changes, message):
    with pytest.raises(ValueError, match=message):
        OptimizeConfig(output="run", target=Target(shape="sphere"), **changes)


def test_negative_numbers():
    with pytest.raises(ValueError, match="gradient: must not be negative, got -1"):
        Level(gradient=-1)
