"""Targets, cameras and lights of a config."""

import dataclasses

import numpy as np
import pytest

from jaxdr.geometry.load import save_mesh
from jaxdr.geometry.shapes import box
from jaxdr.optimize.config import Cameras, Floor, Initial, Light, OptimizeConfig, Target
from jaxdr.optimize.problem import build_problem, build_target, camera_poses


def volume(mesh):
    a, b, c = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)].transpose(1, 0, 2)
    return (np.cross(a, b) * c).sum() / 6


@pytest.mark.parametrize(("up", "extent"), [("z", (1, 2, 4)), ("y", (4, 1, 2)), ("x", (2, 4, 1))])
def test_target_is_centred_scaled_and_upright(tmp_path, up, extent):
    save_mesh(tmp_path / "box.obj", box(size=(1, 2, 4), center=(7, 8, 9)))
    mesh = build_target(Target(path=str(tmp_path / "box.obj"), size=2.0, up=up))
    vertices = np.asarray(mesh.vertices)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), np.array(extent) / 2, rtol=1e-5)
    np.testing.assert_allclose(vertices.max(0) + vertices.min(0), 0, atol=1e-5)
    assert volume(mesh) == pytest.approx(1.0, rel=1e-4)  # positive: outside stays outside


def test_parameters_and_shading_of_procedural_targets():
    coarse = build_target(Target(shape="pawn", parameters={"segments": 8}))
    fine = build_target(Target(shape="pawn", parameters={"segments": 16}, shading="smooth"))
    assert len(coarse.vertices) < len(fine.vertices)
    assert coarse.normal_faces is None and fine.normal_faces is not None
    with pytest.raises(ValueError, match=r"target\.parameters: .*segments must be at least 3"):
        build_target(Target(shape="pawn", parameters={"segments": 2}))


def test_cameras_look_at_the_origin_from_within_the_elevations():
    cameras = Cameras(views=40, distance=2.5, elevation=(-10.0, 60.0))
    poses = camera_poses(cameras)
    position, forward = poses[:, :3, 3], poses[:, :3, 2]
    np.testing.assert_allclose(position, -2.5 * forward, atol=1e-12)
    elevation = np.rad2deg(np.arcsin(position[:, 2] / 2.5))
    assert -10 < elevation.min() < -5 and 50 < elevation.max() < 60
    azimuth = np.sort(np.arctan2(position[:, 1], position[:, 0]))
    assert np.diff(azimuth, append=azimuth[0] + 2 * np.pi).max() < 2.7 * 2 * np.pi / 40  # three-gap theorem


def test_scene_has_what_the_config_says():
    config = OptimizeConfig(
        output="x",
        target=Target(shape="box"),
        initial=Initial(subdivisions=1, radius=0.3, shading="smooth"),
        lights=(Light(position=(0.0, 0.0, 3.0), width=1.0, height=2.0), Light(position=(3.0, 0.0, 1.0))),
        environment=(0.1, 0.2, 0.3),
        floor=Floor(height=-0.6, size=5.0),
    )
    scene = build_problem(config).scene
    assert set(scene.shapes) == {"object", "floor", "light_0", "light_1"}
    np.testing.assert_allclose(np.linalg.norm(scene.shapes["object"].mesh.vertices, axis=1), 0.3, rtol=1e-5)
    assert scene.shapes["object"].mesh.normal_faces is not None
    np.testing.assert_allclose(scene.shapes["floor"].mesh.vertices[:, 2], -0.6)
    np.testing.assert_allclose(scene.environment.radiance, (0.1, 0.2, 0.3), rtol=1e-6)
    for name, light in (("light_0", config.lights[0]), ("light_1", config.lights[1])):
        mesh = scene.shapes[name].mesh
        a, b, c = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)[0]]
        normal = np.cross(b - a, c - a)
        # Faces the origin; two triangles have the whole area.
        np.testing.assert_allclose(
            normal / np.linalg.norm(normal), -np.array(light.position) / np.linalg.norm(light.position), atol=1e-6
        )
        np.testing.assert_allclose(np.linalg.norm(normal), light.width * light.height, rtol=1e-5)
    bare = build_problem(dataclasses.replace(config, floor=None, environment=0.0)).scene
    assert "floor" not in bare.shapes and bare.environment is None
