"""The loop with Adam on a stand-in for the renderer: shape and texture together, stopped, resumed bit for bit."""

import csv
import dataclasses
import json
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry.load import load_mesh
from jaxdr.optimize.config import Cameras, Samples
from jaxdr.optimize.output import RunFolder
from jaxdr.optimize.progress import Interrupted, NotFinite
from jaxdr.optimize.recovery import problem
from jaxdr.optimize.recovery.config import Adam, Parameter, RecoveryConfig, Report, SceneSource, TargetSource
from jaxdr.optimize.recovery.recover import recover

VERTICES, TEXELS = "object.vertices", "object.bsdf.reflectance.pixels"


def fake_render(scene, key, spp, integrator):
    """Gaussian blobs at the projected vertices in the colours of texels, with noise that falls with the samples."""
    size = scene.camera.film.height, scene.camera.film.width
    shape = scene.shapes["object"]
    points = scene.camera.project(shape.mesh.vertices)
    texels = shape.bsdf.bsdf.reflectance.pixels.reshape(-1, 3)
    colors = texels[jnp.arange(len(points)) % len(texels)]
    rows, columns = (jnp.arange(n) + 0.5 for n in size)
    across = jnp.exp(-0.5 * ((columns[:, None] - points[:, 0]) / 1.5) ** 2)
    down = jnp.exp(-0.5 * ((rows[:, None] - points[:, 1]) / 1.5) ** 2)
    image = jnp.einsum("hv,wv,vc->hwc", down, across, colors) * 8.0 / len(points)
    return image * (1 + 0.05 * jax.random.normal(key, (*size, 3)) / spp**0.5)


@pytest.fixture(autouse=True)
def no_rendering(monkeypatch):
    monkeypatch.setattr(problem, "render", fake_render)


@pytest.fixture
def config(tmp_path):
    options = {"shape": "sphere", "subdivisions": 1, "texture": "plain", "texture_height": 4, "size": 0.6}
    return RecoveryConfig(
        output=str(tmp_path / "run"),
        scene=SceneSource("textured_object", options=options),
        target=TargetSource(options={"size": 0.9, "texture": "patches"}),
        parameters=(
            Parameter(VERTICES, smoothing=5.0, learning_rate=0.02),
            Parameter(TEXELS, bounds=(0.0, 1.0), learning_rate=0.1, final_learning_rate=0.05),
        ),
        cameras=Cameras(views=3, resolution=16),
        samples=Samples(target=16, image=4, gradient=4, pictures=4),
        optimizer=Adam(iterations=6, views_per_step=2),
        report=Report(pictures=3, errors=2, checkpoint=2, views=2, chamfer_samples=500),
    )


def checkpoint(config):
    with np.load(f"{config.output}/checkpoint.npz") as file:
        return {name: file[name] for name in file.files if name != "seconds"}


def rows(config):
    with open(f"{config.output}/metrics.csv") as file:
        return [{**row, "seconds": ""} for row in csv.DictReader(file)]


def press_ctrl_c_after(monkeypatch, iteration):
    original = RunFolder.add_metrics

    def add_metrics(self, row):
        original(self, row)
        if row["iteration"] == iteration:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(RunFolder, "add_metrics", add_metrics)


def test_shape_and_texture_improve_together_and_leave_everything(config, tmp_path):
    config = dataclasses.replace(config, optimizer=Adam(iterations=40, views_per_step=2, loss="l2"))
    config = dataclasses.replace(config, report=dataclasses.replace(config.report, pictures=20, errors=20))
    summary = recover(config)
    assert summary["loss_final"] < 0.1 * summary["loss_initial"]
    before, after = summary["errors"][f"{VERTICES} chamfer"]
    assert after < 0.5 * before
    assert summary["errors"]["albedo"][0] > 0
    assert summary == json.loads((tmp_path / "run/metrics.json").read_text())
    written = {str(p.relative_to(tmp_path / "run")) for p in (tmp_path / "run").rglob("*") if p.is_file()}
    numbers = (0, 20, 40)
    assert written == {
        *(
            "jaxdr.json",
            ".jaxdr.lock",
            "report.html",
            "config.json",
            "metrics.csv",
            "metrics.json",
            "targets.npy",
            "checkpoint.npz",
            "result.npz",
        ),
        *(f"pictures/{i:05d}.png" for i in numbers),
        *(f"pictures/{i:05d}.object.bsdf.reflectance.png" for i in numbers),
        *(f"meshes/{i:05d}.object.glb" for i in numbers),
    }
    with np.load(tmp_path / "run/result.npz") as result:
        assert set(result.files) == {VERTICES, TEXELS}
        mesh = load_mesh(tmp_path / "run/meshes/00040.object.glb")
        expected = np.sort(result[VERTICES], axis=0)
        np.testing.assert_allclose(np.sort(mesh.vertices, axis=0), expected, atol=1e-6)
        assert (result[TEXELS] > 0).all() and (result[TEXELS] < 1).all()
    measured = [row["iteration"] for row in rows(config) if row["albedo"]]
    assert measured == ["20", "40"]


def test_ctrl_c_and_resume_end_with_the_same_bits(config, tmp_path, monkeypatch):
    straight = dataclasses.replace(config, output=str(tmp_path / "straight"))
    recover(straight)
    with monkeypatch.context() as patch:
        press_ctrl_c_after(patch, 3)
        with pytest.raises(Interrupted, match=r"after step 3; checkpoint in .*checkpoint\.npz"):
            recover(config)
    assert checkpoint(config)["step"] == 3
    recover(config, resume=True)
    expected, resumed = checkpoint(straight), checkpoint(config)
    assert expected.keys() == resumed.keys()
    for name in expected:
        np.testing.assert_array_equal(expected[name], resumed[name], err_msg=name)
    assert rows(straight) == rows(config)
    with pytest.raises(ValueError, match="this run is finished"):
        recover(config, resume=True)
    with pytest.raises(ValueError, match=r"config differs from the recovery's: parameters was"):
        recover(dataclasses.replace(config, parameters=config.parameters[:1]), resume=True)


def test_nan_stops_the_run_and_is_named(config, monkeypatch):
    def bad_render(scene, key, spp, integrator):
        image = fake_render(scene, key, spp, integrator)
        return image * jnp.nan if spp == 3 else image  # targets and pictures are fine

    monkeypatch.setattr(problem, "render", bad_render)
    config = dataclasses.replace(config, samples=dataclasses.replace(config.samples, image=3))
    with pytest.raises(NotFinite, match=r"the loss of view [012] is not finite in step 1; .*checkpoint\.npz"):
        recover(config)
    assert checkpoint(config)["step"] == 0
