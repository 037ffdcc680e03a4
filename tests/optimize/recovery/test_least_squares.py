"""Levenberg-Marquardt: the filter, the Jacobian, resuming, and a light and a camera that are found for real."""

import csv
import dataclasses
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.optimize.config import Integrator, Samples
from jaxdr.optimize.output import RunFolder
from jaxdr.optimize.progress import Interrupted
from jaxdr.optimize.recovery import problem
from jaxdr.optimize.recovery.config import LevenbergMarquardt, Parameter, RecoveryConfig, Report, SceneSource
from jaxdr.optimize.recovery.least_squares import LeastSquaresSteps, gaussian_filter
from jaxdr.optimize.recovery.problem import build_problem
from jaxdr.optimize.recovery.recover import recover

SCENE = """<scene version="3.0.0">
    <sensor type="perspective" id="camera">
        <float name="fov" value="50"/>
        <transform name="to_world"><lookat origin="0.5, -4, 3" target="0, 0, 0.3" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/></film>
    </sensor>
    <shape type="rectangle" id="floor"><transform name="to_world"><scale value="4"/></transform></shape>
    <shape type="cube" id="block">
        <bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.4, 0.2"/></bsdf>
        <transform name="to_world"><scale value="0.5"/><translate x="0.2" z="0.5"/></transform>
    </shape>
    <emitter type="point" id="lamp">
        <point name="position" x="1.5" y="-1" z="3"/><rgb name="intensity" value="20, 20, 20"/>
    </emitter>
</scene>
"""


@pytest.fixture
def config(tmp_path):
    (tmp_path / "scene.xml").write_text(SCENE)
    return RecoveryConfig(
        output=str(tmp_path / "run"),
        scene=SceneSource(file=str(tmp_path / "scene.xml")),
        parameters=(
            Parameter("lamp.position", initial=(1.0, -1.3, 3.4)),
            Parameter("camera.to_world", motion="translation", initial=(0.15, 0.1, -0.1)),
        ),
        integrator=Integrator(boundary="LineSampling"),
        samples=Samples(target=256, image=64, gradient=64, pictures=64),
        optimizer=LevenbergMarquardt(iterations=12),
        report=Report(pictures=20, errors=1, checkpoint=20),
    )


def rows(config):
    with open(f"{config.output}/metrics.csv") as file:
        return [{**row, "seconds": ""} for row in csv.DictReader(file)]


def smooth_render(scene, key, spp, integrator):
    """Blobs at the projected corners of the block, as bright as the light is near; with noise."""
    points = scene.shapes["block"].mesh.vertices
    on_film = scene.camera.project(points)
    distance = jnp.linalg.norm(points - scene.lights["lamp"].position, axis=-1)
    places = jnp.arange(12) + 0.5
    across = jnp.exp(-0.5 * ((places[:, None] - on_film[:, 0]) / 1.5) ** 2)
    down = jnp.exp(-0.5 * ((places[:, None] - on_film[:, 1]) / 1.5) ** 2)
    image = jnp.einsum("hv,wv,v->hw", down, across, 10.0 / distance**2)[..., None]
    return image * (1 + 0.02 * jax.random.normal(key, (12, 12, 3)) / spp**0.5)


def test_a_light_is_found(config):
    summary = recover(dataclasses.replace(config, parameters=config.parameters[:1]))
    before, after = summary["errors"]["lamp.position"]
    assert summary["iterations"] <= 12 and after < 0.05 < 0.2 * before


@pytest.mark.slow
def test_light_and_camera_are_found(config):
    summary = recover(config)
    assert summary["iterations"] <= 12
    for name, allowed in (("lamp.position", 0.05), ("camera.to_world distance", 0.02)):
        before, after = summary["errors"][name]
        assert after < allowed < 0.2 * before, (name, before, after)


def test_resumed_run_ends_with_the_same_bits(config, tmp_path, monkeypatch):
    monkeypatch.setattr(problem, "render", smooth_render)
    optimizer = LevenbergMarquardt(iterations=9, blur=(1.5, 0.0), tolerance=1e-9)
    config = dataclasses.replace(config, optimizer=optimizer)
    straight = dataclasses.replace(config, output=str(tmp_path / "straight"))
    summary = recover(straight)
    assert max(after for _, after in summary["errors"].values()) < 0.1
    original = RunFolder.add_metrics

    def add_metrics(self, row):
        original(self, row)
        if row["iteration"] == 6:  # with the second blur
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "add_metrics", add_metrics)
        with pytest.raises(Interrupted):
            recover(config)
    recover(config, resume=True)
    assert rows(straight) == rows(config)
    files = [dict(np.load(f"{c.output}/checkpoint.npz")) for c in (straight, config)]
    assert files[0].keys() == files[1].keys()
    for name in files[0].keys() - {"seconds"}:
        np.testing.assert_array_equal(files[0][name], files[1][name], err_msg=name)


def test_jacobian_is_that_of_the_residuals(config, monkeypatch):
    def noiseless(scene, key, spp, integrator):
        return smooth_render(scene, key, 10**16, integrator)

    monkeypatch.setattr(problem, "render", noiseless)
    made = build_problem(config)
    steps = LeastSquaresSteps(config, LevenbergMarquardt(blur=(1.0,)), made, jax.random.key(0), jax.devices()[:1])
    targets = np.asarray(noiseless(made.target, jax.random.key(0), 1, None))[None]
    arguments = steps._arguments(targets, jnp.full_like(steps.start, 3.0), 0)
    found = jax.jacfwd(lambda x: steps.residuals(x, arguments))(3.0 * steps.start)
    assert found.shape == (12 * 12 * 3, 6)
    for k in range(6):
        step = 0.03 * np.eye(6)[k]
        ahead, behind = (steps.residuals(3.0 * steps.start + s * step, arguments) for s in (1, -1))
        np.testing.assert_allclose(found[:, k], (ahead - behind) / 0.06, atol=2e-3 * np.abs(found).max())


def test_what_it_cannot_do_is_said_at_the_start(config, monkeypatch):
    monkeypatch.setattr(problem, "render", smooth_render)
    still = dataclasses.replace(config, parameters=(Parameter("floor.bsdf.reflectance"),))
    with pytest.raises(ValueError, match=r"floor\.bsdf\.reflectance: the images do not depend on all of it"):
        recover(still)
    scene = SceneSource("still_life")
    many = dataclasses.replace(config, scene=scene, parameters=(Parameter("ball.vertices"),))
    with pytest.raises(ValueError, match=r'"levenberg_marquardt" takes at most 256 numbers, .* are 1926; take "adam"'):
        recover(many)


def test_gaussian_filter():
    np.testing.assert_array_equal(gaussian_filter(5, 0.0), np.eye(5))
    weights = gaussian_filter(41, 2.0)
    np.testing.assert_allclose(weights.sum(1), 1.0)
    apart = np.arange(41) - 20
    assert (weights[20] * apart**2).sum() == pytest.approx(4.0, rel=1e-3)
