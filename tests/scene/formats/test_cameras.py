"""Files with several cameras: one of them is chosen, by its id or by its number."""

import argparse

import pytest

import jaxdr as jd
from experiments.real_scenes.gltf_writer import File
from jaxdr import cli
from jaxdr.scene.formats.mitsuba.settings import mitsuba_settings

SENSORS = """
<sensor type="perspective" id="front"><float name="fov" value="30"/>
    <sampler type="independent"><integer name="sample_count" value="4"/></sampler></sensor>
<sensor type="perspective"><float name="fov" value="40"/>
    <sampler type="independent"><integer name="sample_count" value="8"/></sampler></sensor>
<sensor type="orthographic" id="top"/>
<shape type="cube"/>"""
LISTED = "0: 'front', 1: without id, 2: 'top'"


@pytest.mark.parametrize(("sensor", "fov", "spp"), [("front", 30, 4), (0, 30, 4), (1, 40, 8), ("top", None, None)])
def test_a_sensor_is_chosen(load, scene_file, sensor, fov, spp):
    camera = load(SENSORS, sensor=sensor).camera
    assert isinstance(camera, jd.Orthographic) if fov is None else float(camera.fov) == fov
    assert mitsuba_settings(scene_file(SENSORS), sensor=sensor).spp == spp


def test_without_a_choice_the_error_lists_them(load):
    with pytest.raises(ValueError, match=r"line 5, <sensor>: the scene has several sensors \(" + LISTED) as caught:
        load(SENSORS)
    assert "choose one by its id or its number: sensor='front' (--set sensor=front)" in str(caught.value)
    with pytest.warns(UserWarning, match="the first one counts"):
        assert float(load(SENSORS, ignore_unsupported=True).camera.fov) == 30


@pytest.mark.parametrize("sensor", ["side", 3, -1])
def test_a_sensor_that_is_not_there(load, scene_file, sensor):
    for read in (load, lambda text, **options: mitsuba_settings(scene_file(text), **options)):
        with pytest.raises(ValueError, match=f"there is no sensor {sensor!r}; the scene has {LISTED}"):
            read(SENSORS, sensor=sensor)


def test_a_sensor_that_is_not_chosen_may_be_unsupported(load):
    text = '<sensor type="fisheye" id="eye"/><sensor type="perspective" id="front"/><shape type="cube"/>'
    assert load(text, sensor="front").camera.film.width == 768
    with pytest.raises(ValueError, match="unknown type 'fisheye'"):
        load(text, sensor="eye")


def two_cameras(path):
    file = File()
    file.node(mesh=file.mesh(), name="cube")
    for yfov, node, name in ((0.5, "front", "lens"), (1.0, None, "wide")):
        camera = file.add("cameras", {"type": "perspective", "perspective": {"yfov": yfov, "znear": 1}, "name": name})
        file.node(camera=camera, **({"name": node} if node else {}))
    return file.save(path)


@pytest.mark.parametrize(
    ("camera", "degrees"), [(None, 28.65), ("front", 28.65), ("lens", 28.65), ("wide", 57.3), (1, 57.3)]
)
def test_a_camera_of_gltf(tmp_path, camera, degrees):
    found = jd.load_gltf(two_cameras(tmp_path / "a.glb"), camera=camera).camera
    assert float(found.fov) == pytest.approx(degrees, abs=0.01)


@pytest.mark.parametrize("camera", ["back", 2, -1])
def test_a_camera_of_gltf_that_is_not_there(tmp_path, camera):
    message = f"there is no camera {camera!r}; the scene has 0: 'front' or 'lens', 1: 'wide'"
    with pytest.raises(ValueError, match=message):
        jd.load_gltf(two_cameras(tmp_path / "a.glb"), camera=camera)


def test_the_same_name_twice_is_no_choice(tmp_path):
    file = File()
    file.node(mesh=file.mesh())
    for _ in range(2):
        lens = {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 1}, "name": "lens"}
        file.node(camera=file.add("cameras", lens))
    with pytest.raises(ValueError, match="several cameras are called 'lens'; choose one by its number: 0: 'lens', 1"):
        jd.load_gltf(file.save(tmp_path / "a.glb"), camera="lens")


@pytest.mark.parametrize(("choice", "fov"), [("sensor=front", 30), ("sensor=1", 40)])
def test_a_command_chooses(scene_file, choice, fov):
    options = argparse.Namespace(scene=scene_file(SENSORS), set=[choice], ignore_unsupported=False)
    assert float(cli._load_scene(options).camera.fov) == fov


def test_a_command_chooses_in_gltf(tmp_path):
    path = two_cameras(tmp_path / "a.glb")
    options = argparse.Namespace(scene=path, set=["camera=wide", "width=9"], ignore_unsupported=False)
    camera = cli._load_scene(options).camera
    assert float(camera.fov) == pytest.approx(57.3, abs=0.01) and camera.film.width == 9
