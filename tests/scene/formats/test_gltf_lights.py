"""Lights and parallel cameras of glTF files."""

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.real_scenes.gltf_writer import File
from jaxdr.scene.formats.gltf.load import load_gltf
from jaxdr.scene.lights import DirectionalLight, PointLight, SpotLight

HALF = 0.5**0.5


def scene(tmp_path, *lights, **nodes):
    """A cube with lights at nodes."""
    file = File(extensions={"KHR_lights_punctual": {"lights": list(lights)}})
    file.uses("KHR_lights_punctual")
    file.node(mesh=file.mesh(), name="cube")
    for i, (name, node) in enumerate(nodes.items()):
        file.node(name=name, extensions={"KHR_lights_punctual": {"light": i}}, **node)
    return load_gltf(file.save(tmp_path / "a.glb"))


def test_lights_at_their_nodes(tmp_path):
    """Candela are W / sr, lux are W / m²; -z is where they shine; scale has no effect; they replace the sky."""
    found = scene(
        tmp_path,
        {"type": "directional", "color": [1, 0.5, 0.25], "intensity": 4},
        {"type": "point", "intensity": 100},
        {"type": "spot", "intensity": 7, "spot": {"innerConeAngle": np.pi / 8, "outerConeAngle": np.pi / 3}},
        {"type": "spot"},
        sun={},
        bulb={"translation": [0, 5, 0], "scale": [9, 9, 9]},
        beam={"translation": [-5, 0, 0], "rotation": [0, -HALF, 0, HALF], "scale": [3, 3, 3]},  # along +x
        cube={},
    )
    assert found.environment is None and list(found.lights) == ["beam", "bulb", "cube_1", "sun"]
    sun, bulb, beam = (found.lights[name] for name in ("sun", "bulb", "beam"))
    assert isinstance(sun, DirectionalLight) and isinstance(bulb, PointLight) and isinstance(beam, SpotLight)
    np.testing.assert_allclose(sun.irradiance, [4, 2, 1])
    np.testing.assert_allclose(sun.place(), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(bulb.intensity, [100] * 3)
    np.testing.assert_allclose(bulb.place(), [0, 5, 0])
    np.testing.assert_allclose(beam.place(), [-5, 0, 0])
    angles = np.radians([0, 22, 59.9, 60.1])
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(4)], 1)
    shares = np.asarray(beam.intensity_in(jnp.asarray(directions, float)))[:, 0] / 7
    np.testing.assert_allclose(shares[[0, 1, 3]], [1, 1, 0], atol=1e-5)
    assert 0 < shares[2] < 0.01
    cone = found.lights["cube_1"]  # the specification's defaults
    np.testing.assert_allclose([cone.beam_width, cone.cutoff_angle], [0, 45], rtol=1e-6)


def test_a_light_of_an_unknown_type_is_an_error(tmp_path):
    with pytest.raises(ValueError, match=r"node 'lamp': KHR_lights_punctual: a light must be of type .*, not 'area'"):
        scene(tmp_path, {"type": "area"}, lamp={})


def test_a_parallel_camera(tmp_path):
    """It shows 6 by 2 units around its axis, whatever the film's size."""
    file = File()
    lens = {"xmag": 3, "ymag": 1, "znear": 0, "zfar": 100}
    number = file.add("cameras", {"type": "orthographic", "orthographic": lens})
    file.node(mesh=file.mesh())
    file.node(camera=number, translation=[1, 2, 10])
    path = file.save(tmp_path / "a.glb")
    for height in (None, 30):
        camera = load_gltf(path, width=30, height=height).camera
        assert camera.film.height == (height or 10)
        film = np.asarray(camera.project(jnp.array([[1.0, 2, 0], [4, 3, 0], [-2, 1, 5]])))
        expected = np.array([[0.5, 0.5], [1, 0], [0, 1]]) * [30, camera.film.height]
        np.testing.assert_allclose(film, expected, atol=1e-4)
