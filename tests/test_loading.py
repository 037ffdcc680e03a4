"""Making and loading scenes compiles nothing: XLA would take longer than all the rest, once for every size."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.arrays import as_array
from jaxdr.scene.motion import motion


@pytest.fixture
def compiled():
    """Names of the programs that were compiled."""
    found = []

    def listen(event, duration, **details):
        if event.endswith("backend_compile_duration"):
            found.append(details.get("fun_name"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield found
    jax.monitoring.unregister_event_duration_listener(listen)


def test_the_fixture_sees_programs(compiled):
    jax.jit(lambda x: x * 1.7)(np.ones(23, np.float32))
    assert compiled


def test_meshes_and_files(compiled, tmp_path):
    ball = jd.shapes.transformed(jd.shapes.sphere(subdivisions=2), np.diag([-1.0, 2.0, 1.0, 1.0]))
    jd.save_mesh(tmp_path / "ball.ply", ball)
    compiled.clear()
    jd.load_mesh(tmp_path / "ball.ply", shading="smooth")
    jd.Mesh(np.random.default_rng(0).random((7, 3)), np.array([[0, 1, 2], [4, 5, 6]])).with_vertices(np.ones((7, 3)))
    assert not compiled


def test_a_scene(compiled):
    rng = np.random.default_rng(0)
    pose, picture = jd.look_at((0, 0, 5), (0, 0, 0), (0, 1, 0)), rng.random((37, 41, 3))
    plate = jd.shapes.rectangle()
    scene = jd.Scene(
        {
            "plate": jd.Shape(plate, jd.Diffuse(jd.Bitmap(picture))),
            "board": jd.Shape(plate, jd.RoughConductor(jd.Bitmap(picture[..., 0]), material="Au")),
            "glass": jd.Shape(jd.shapes.sphere(), jd.RoughDielectric(0.2)),
            "light": jd.Shape(plate, jd.Diffuse(jd.Checkerboard(0.2, (0.1, 0.2, 0.3))), jd.AreaEmitter(3.0)),
        },
        jd.Perspective(pose, 40, jd.Film(31, 29)),
        jd.EnvironmentMap(rng.random((9, 13, 3))),
        {
            "point": jd.PointLight((0, 1, 2)),
            "spot": jd.SpotLight((0, 0, 1), (0, 1, 0)),
            "sun": jd.DirectionalLight((0, 0, 1)),
        },
    )
    values = {name: np.asarray(value, np.float64) for name, value in scene.parameters().items()}
    scene = scene.replace(values)
    for name in ("glass.rotate.x", "glass.translate.y", "camera.rotate.z", "camera.fov"):
        motion(scene, name)
    assert not compiled


def test_as_array_copies_and_converts():
    source = np.arange(6.0).reshape(2, 3)
    array = as_array(source)
    source[:] = -1.0
    assert array.dtype == jax.numpy.result_type(float) and array[1, 2] == 5.0
    assert not as_array(0.5).weak_type
    np.testing.assert_array_equal(jax.jit(lambda x: as_array([x, 2.0, 3]))(1.0), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(jax.grad(lambda x: as_array([x, 2.0])[0] * x)(3.0), 6.0)
