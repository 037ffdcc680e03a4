"""The asset: a GLB that looks in `load_gltf` as vertex colours and textures did."""

import json

import jax
import numpy as np
import pytest
import trimesh

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.images import from_srgb
from jaxdr.optimize.reconstruction.asset import write_glb
from jaxdr.optimize.reconstruction.atlas import bake, unwrapped
from jaxdr.scene.camera import look_at

pytest.importorskip("xatlas")


def painted():
    mesh = shapes.sphere(3, radius=0.5).smooth()
    points = np.asarray(mesh.vertices, float)
    albedo = 0.4 + 0.5 * points * [1, -1, 0.5]
    return mesh, albedo, 0.5 + 0.4 * points[:, 2]


def test_the_file_has_textures_normals_and_its_place(tmp_path):
    mesh, albedo, roughness = painted()
    write_glb(tmp_path / "asset.glb", mesh, albedo, roughness, 256)
    loaded = trimesh.load_scene(tmp_path / "asset.glb", process=False)
    (geometry,) = loaded.geometry.values()
    assert "vertex_normals" in geometry._cache
    material = geometry.visual.material
    assert material.baseColorTexture.size == (256, 256) and material.metallicFactor == 0
    np.testing.assert_allclose(np.ptp(geometry.vertices, axis=0), 1, atol=0.02)
    base = from_srgb(np.asarray(material.baseColorTexture)[..., :3] / 255)
    assert abs(base.mean() - albedo.mean()) < 0.05
    data = (tmp_path / "asset.glb").read_bytes()
    header = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert len(header["meshes"]) == 1 and "extensionsRequired" not in header


@pytest.mark.parametrize("textured", [False, True])
def test_it_looks_as_the_paint_did(tmp_path, textured):
    mesh, albedo, roughness = painted()
    paint = jd.VertexColors(albedo)
    if textured:
        mesh = unwrapped(mesh, 256)
        albedo = bake(mesh, albedo, 256)
        paint = jd.Bitmap(albedo)
    write_glb(tmp_path / "asset.glb", mesh, albedo, roughness, 256)
    bsdf = jd.Principled(paint, 0.0, jd.VertexColors(roughness[:, None]))
    camera = jd.Perspective(look_at((0.5, -2, 0.7), (0, 0, 0), (0, 0, 1)), 35.0, jd.Film(32, 32))
    loaded = jd.load_gltf(tmp_path / "asset.glb", width=32)
    tracer, key = jd.PathTracer(max_depth=2, boundary=None), jax.random.key(0)
    sky = jd.EnvironmentMap(np.random.default_rng(0).uniform(0, 2, (5, 8, 3)))
    scenes = [jd.Scene({"object": jd.Shape(mesh, bsdf)}, camera, sky), jd.Scene(loaded.shapes, camera, sky)]
    one, other = (np.asarray(jd.render(scene, key, spp=16, integrator=tracer)) for scene in scenes)
    assert np.abs(one - other).mean() < 0.01 * one.mean()


def test_without_xatlas_its_remedy_is_said(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "xatlas", None)
    with pytest.raises(ImportError, match=r"\.\[reconstruct\]"):
        unwrapped(painted()[0], 64)
