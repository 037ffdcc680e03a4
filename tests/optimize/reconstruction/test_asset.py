"""The asset: textures over an atlas, and a GLB that looks in `load_gltf` as the vertex colours did."""

import json

import jax
import numpy as np
import pytest
import trimesh

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.images import from_srgb
from jaxdr.optimize.reconstruction.asset import bake, unwrap, write_glb
from jaxdr.scene.camera import look_at

pytest.importorskip("xatlas")


def painted():
    mesh = shapes.sphere(3, radius=0.5).smooth()
    points = np.asarray(mesh.vertices, float)
    albedo = 0.4 + 0.5 * points * [1, -1, 0.5]
    return mesh, albedo, 0.5 + 0.4 * points[:, 2]


def test_charts_do_not_overlap_and_textures_are_what_the_vertices_say():
    mesh, albedo, _ = painted()
    atlas, size = unwrap(mesh), 256
    assert (np.asarray(mesh.faces) == atlas.vertices[atlas.faces]).all()
    assert 0 <= atlas.uvs.min() and atlas.uvs.max() <= 1
    corners = atlas.uvs[atlas.faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum() / 2 < 1
    texture = bake(atlas, albedo, size)
    # At the middle of every face, (0, 0) at the lower left.
    middle = corners.mean(1)
    row, column = ((1 - middle[:, 1]) * size).astype(int), (middle[:, 0] * size).astype(int)
    wanted = albedo[np.asarray(mesh.faces)].mean(1)
    np.testing.assert_allclose(texture[row, column], wanted, atol=0.02)
    # Beyond the charts the nearest values go on.
    assert texture.min() > 0.1 and texture.max() < 0.7


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


def test_it_looks_as_the_vertex_colours_did(tmp_path):
    mesh, albedo, roughness = painted()
    write_glb(tmp_path / "asset.glb", mesh, albedo, roughness, 256)
    bsdf = jd.Principled(jd.VertexColors(albedo), 0.0, jd.VertexColors(roughness[:, None]))
    camera = jd.Perspective(look_at((0.5, -2, 0.7), (0, 0, 0), (0, 0, 1)), 35.0, jd.Film(32, 32))
    loaded = jd.load_gltf(tmp_path / "asset.glb", width=32)
    tracer, key = jd.PathTracer(max_depth=2, boundary=None), jax.random.key(0)
    sky = jd.EnvironmentMap(np.random.default_rng(0).uniform(0, 2, (5, 8, 3)))
    scenes = [jd.Scene({"object": jd.Shape(mesh, bsdf)}, camera, sky), jd.Scene(loaded.shapes, camera, sky)]
    one, other = (np.asarray(jd.render(scene, key, spp=16, integrator=tracer)) for scene in scenes)
    assert np.abs(one - other).mean() < 0.01 * one.mean()


def test_without_xatlas_its_remedy_is_said(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "xatlas", None)
    with pytest.raises(ImportError, match=r"jaxdr\[reconstruct\]"):
        unwrap(painted()[0])
