"""The optimisation loop on a stand-in for the renderer: it improves, writes, stops, resumes, refuses."""

import csv
import dataclasses
import json
import shutil
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry.load import load_mesh
from jaxdr.optimize import phase, shape, targets
from jaxdr.optimize.config import Cameras, Initial, OptimizeConfig, Optimizer, Remesh, Report, Samples, Target
from jaxdr.optimize.preconditioner import LargeSteps
from jaxdr.optimize.problem import OBJECT, build_problem, views_of_step
from jaxdr.optimize.progress import Interrupted, NotFinite
from jaxdr.optimize.shape import optimize

from .fake import render as fake_render


@pytest.fixture(autouse=True)
def no_rendering(monkeypatch):
    monkeypatch.setattr(phase, "render", fake_render)


def small_config(output):
    return OptimizeConfig(
        output=str(output),
        target=Target(shape="sphere", parameters={"subdivisions": 2}, size=0.9),
        initial=Initial(subdivisions=2, radius=0.3),
        cameras=Cameras(views=3, resolution=16),
        samples=Samples(target=16, image=4, gradient=4, pictures=4),
        optimizer=Optimizer(iterations=6, views_per_step=2, learning_rate=0.01, lam=5.0),
        report=Report(pictures=3, chamfer=2, checkpoint=2, views=2, chamfer_samples=500),
    )


@pytest.fixture
def config(tmp_path):
    return small_config(tmp_path / "run")


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """A run from beginning to end; not to be changed."""
    config = small_config(tmp_path_factory.mktemp("straight") / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(phase, "render", fake_render)
        optimize(config)
    return config


def copied(config, tmp_path):
    shutil.copytree(config.output, tmp_path / "run")
    return dataclasses.replace(config, output=str(tmp_path / "run"))


def with_optimizer(config, **changes):
    return dataclasses.replace(config, optimizer=dataclasses.replace(config.optimizer, **changes))


def rows(config):
    with open(f"{config.output}/metrics.csv") as file:
        return list(csv.DictReader(file))


def checkpoint(config):
    with np.load(f"{config.output}/checkpoint.npz") as file:
        return {name: file[name] for name in file.files if name != "seconds"}


def press_ctrl_c_after(monkeypatch, iteration):
    """A real SIGINT while that iteration is being recorded."""
    original = shape.RunFolder.add_metrics

    def add_metrics(self, row):
        original(self, row)
        if row["iteration"] == iteration:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(shape.RunFolder, "add_metrics", add_metrics)


def test_a_run_improves_and_leaves_everything(config, tmp_path):
    config = with_optimizer(config, iterations=30, learning_rate=0.03)
    summary = optimize(config)
    losses = [float(row["loss"]) for row in rows(config)]
    assert len(losses) == 30
    assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:5])
    assert [row["iteration"] for row in rows(config) if row["chamfer"]] == [str(i) for i in range(2, 31, 2)]
    assert summary == json.loads((tmp_path / "run/metrics.json").read_text())
    assert summary["chamfer_final"] == float(rows(config)[-1]["chamfer"])
    written = {str(p.relative_to(tmp_path / "run")) for p in (tmp_path / "run").rglob("*") if p.is_file()}
    numbers = range(0, 31, 3)
    assert written == {
        *("jaxdr.json", ".jaxdr.lock", "config.json", "metrics.csv", "metrics.json", "report.html"),
        *("targets.npy", "checkpoint.npz"),
        *(f"pictures/{i:05d}.png" for i in numbers),
        *(f"meshes/{i:05d}.glb" for i in numbers),
        *("meshes/target.glb", "meshes/result.glb"),
    }
    # The result is the state in the checkpoint.
    steps = LargeSteps(initial_mesh(config), config.optimizer.lam)
    expected = steps.from_latent(jnp.asarray(checkpoint(config)["state/latent"]))
    result = load_mesh(tmp_path / "run/meshes/result.glb")
    np.testing.assert_allclose(np.sort(result.vertices, axis=0), np.sort(expected, axis=0), atol=1e-6)


def initial_mesh(config):
    return build_problem(config).scene.shapes[OBJECT].mesh


def test_another_seed_gives_another_result(config, straight):
    other = dataclasses.replace(config, seed=1)
    optimize(other)
    assert not np.array_equal(checkpoint(straight)["state/latent"], checkpoint(other)["state/latent"])


def test_ctrl_c_and_resume_end_with_the_same_bits(config, straight, monkeypatch):
    with monkeypatch.context() as patch:
        press_ctrl_c_after(patch, 3)
        with pytest.raises(Interrupted, match=r"after step 3; checkpoint in .*checkpoint\.npz"):
            optimize(config)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert len(rows(config)) == checkpoint(config)["step"] == 3
    optimize(config, resume=True)

    expected, resumed = checkpoint(straight), checkpoint(config)
    assert expected.keys() == resumed.keys()
    for name in expected:
        np.testing.assert_array_equal(expected[name], resumed[name], err_msg=name)
    timeless = [[{**row, "seconds": ""} for row in rows(c)] for c in (straight, config)]
    assert timeless[0] == timeless[1]


def test_resume_after_a_crash_repeats_the_lost_steps(config, monkeypatch):
    def crash(self, row):
        original(self, row)
        if row["iteration"] == 5:
            raise RuntimeError("power cut")

    original = shape.RunFolder.add_metrics
    with monkeypatch.context() as patch:
        patch.setattr(shape.RunFolder, "add_metrics", crash)
        with pytest.raises(RuntimeError, match="power cut"):
            optimize(config)
    assert checkpoint(config)["step"] == 4
    optimize(config, resume=True)
    assert [row["iteration"] for row in rows(config)] == list("123456")


def test_interrupted_while_rendering_targets(config, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(targets.Progress, "step", lambda self, **values: signal.raise_signal(signal.SIGINT))
        with pytest.raises(Interrupted, match="while rendering the target views"):
            optimize(config)
    optimize(config, resume=True)
    assert len(rows(config)) == 6


def test_remeshing_starts_the_optimiser_afresh_and_resumes(config, tmp_path, monkeypatch):
    pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install -e ".[remesh]"')
    config = with_optimizer(config, remesh=(Remesh(iteration=3, edge_length=0.15),))
    straight = dataclasses.replace(config, output=str(tmp_path / "straight"))
    optimize(straight)
    counts = [int(row["vertices"]) for row in rows(straight)]
    assert counts[0] == counts[2] == 162 and counts[3] == counts[5] != 162
    assert checkpoint(straight)["start"] == 3
    assert int(checkpoint(straight)["state/optimizer/0/count"]) == 3  # steps since then

    with monkeypatch.context() as patch:
        press_ctrl_c_after(patch, 4)
        with pytest.raises(Interrupted):
            optimize(config)
    optimize(config, resume=True)
    for name, value in checkpoint(straight).items():
        np.testing.assert_array_equal(value, checkpoint(config)[name], err_msg=name)


def test_remeshing_along_a_field(config):
    pytest.importorskip("pyinstantmeshes", reason='it is optional: pip install -e ".[field-aligned]"')
    optimize(with_optimizer(config, remesh=(Remesh(iteration=3, vertices=200, field_aligned=True),)))
    assert [row["vertices"] for row in rows(config)] == ["162"] * 3 + ["200"] * 3


def test_a_failed_remeshing_is_said_and_survived(config, monkeypatch, capsys):
    def fail(mesh, edge_length):
        raise ValueError("remesh: the result is not manifold")

    monkeypatch.setattr(shape, "require_gpytoolbox", lambda: None)
    monkeypatch.setattr(shape, "remesh", fail)
    optimize(with_optimizer(config, remesh=(Remesh(iteration=3, edge_length=0.15),)))
    assert "after step 3: kept the mesh as it was (remesh: the result is not manifold)" in capsys.readouterr().err
    assert {row["vertices"] for row in rows(config)} == {"162"}


def test_missing_packages_are_found_before_anything_is_written(config, tmp_path, monkeypatch):
    def missing():
        raise ImportError('pip install -e ".[remesh]"')

    monkeypatch.setattr(shape, "require_gpytoolbox", missing)
    with pytest.raises(ImportError):
        optimize(with_optimizer(config, remesh=(Remesh(iteration=3, edge_length=0.15),)))
    monkeypatch.setattr(shape, "require_pyinstantmeshes", missing)
    with pytest.raises(ImportError):
        optimize(with_optimizer(config, remesh=(Remesh(iteration=3, vertices=99, field_aligned=True),)))
    assert not (tmp_path / "run").exists()


def test_a_remeshing_that_never_comes_needs_no_package(config, monkeypatch):
    def missing():
        raise ImportError('pip install -e ".[remesh]"')

    monkeypatch.setattr(shape, "require_gpytoolbox", missing)
    assert (
        optimize(with_optimizer(config, remesh=(Remesh(iteration=10, edge_length=0.15, every=2),)))["iterations"] == 6
    )


@pytest.mark.parametrize("broken", ["loss", "gradient"])
def test_nan_stops_the_run_and_is_named(config, monkeypatch, broken):
    @jax.custom_jvp
    def nan_in_derivative(x):
        return x

    nan_in_derivative.defjvp(lambda primals, tangents: (primals[0], tangents[0] * jnp.nan))

    def bad_render(scene, key, spp, integrator):
        image = fake_render(scene, key, spp, integrator)
        if spp != 3:  # targets and pictures are fine
            return image
        return image * jnp.nan if broken == "loss" else nan_in_derivative(image)

    monkeypatch.setattr(phase, "render", bad_render)
    config = dataclasses.replace(config, samples=dataclasses.replace(config.samples, image=3, gradient=3))
    with pytest.raises(NotFinite, match=rf"the {broken} of view [012] is not finite in step 1; .*checkpoint\.npz"):
        optimize(config)
    assert checkpoint(config)["step"] == 0


def test_results_are_not_overwritten_unasked(straight, tmp_path):
    config = copied(straight, tmp_path)
    before = checkpoint(config)["state/latent"]
    changed = dataclasses.replace(config, seed=3)
    with pytest.raises(ValueError, match="already holds results; give --resume or --overwrite"):
        optimize(changed)
    with pytest.raises(ValueError, match="exclude each other"):
        optimize(changed, resume=True, overwrite=True)
    with pytest.raises(ValueError, match=r"config differs from the shape optimisation's: seed was 0, is 3"):
        optimize(changed, resume=True)
    with pytest.raises(ValueError, match="this run is finished"):
        optimize(config, resume=True)
    np.testing.assert_array_equal(checkpoint(config)["state/latent"], before)
    optimize(changed, overwrite=True)
    assert not np.array_equal(checkpoint(config)["state/latent"], before)


def test_a_folder_of_something_else_is_left_alone(config, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run/thesis.tex").write_text("precious")
    for overwrite in (False, True):
        with pytest.raises(ValueError, match="not the folder of a shape optimisation"):
            optimize(config, overwrite=overwrite)
    with pytest.raises(ValueError, match="there is no shape optimisation to resume"):
        optimize(config, resume=True)
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["thesis.tex"]


def test_a_damaged_checkpoint_is_named(straight, tmp_path):
    config = copied(straight, tmp_path)
    with open(f"{config.output}/checkpoint.npz", "r+b") as file:
        file.truncate(100)
    (tmp_path / "run/metrics.json").unlink()
    with pytest.raises(ValueError, match=r"checkpoint\.npz: is damaged, it is not a readable checkpoint"):
        optimize(config, resume=True)


def test_every_view_comes_once_a_round():
    stream = [view for i in range(15) for view in views_of_step(5, 3, i, seed=0)]
    rounds = np.reshape(stream, (-1, 5))
    assert all(sorted(r) == [0, 1, 2, 3, 4] for r in rounds)
    assert len({tuple(r) for r in rounds}) > 1


def test_gradient_is_that_of_the_loss(config):
    # Without noise and with L2 the estimate is the derivative of the loss itself, whatever the number of images.
    def noiseless(vertices, to_world, key, spp):
        moved = build.scene.replace({"object.vertices": vertices, "camera.to_world": to_world})
        return fake_render(moved, key, 10**12, None)

    build = build_problem(config)
    vertices, pose = build.scene.shapes[OBJECT].mesh.vertices, jnp.asarray(build.views[1], float)
    key = jax.random.key(0)
    target = noiseless(0.9 * vertices, pose, key, 1)
    expected = jax.grad(lambda v: ((noiseless(v, pose, key, 1) - target) ** 2).mean())(vertices)
    for loss in ("l2", "two_key_l2"):
        _, gradient = phase.view_gradient(noiseless, loss, 4, 4)(vertices, pose, target, key)
        np.testing.assert_allclose(gradient, expected, rtol=1e-3, atol=1e-7)
