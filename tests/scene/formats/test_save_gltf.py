"""Shapes as GLB files: what `load_gltf` reads is what was written."""

import json

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.uvs import spherical_uvs
from jaxdr.scene.scene import unwrap

RNG = np.random.default_rng(0)
SMOOTH = spherical_uvs(jd.shapes.sphere(1, radius=0.7)).smooth()
PICTURE = RNG.random((4, 6, 3))
NUMBERS = (0.25 + 0.5 * RNG.random((4, 6))).astype(np.float32)
COLORS = RNG.random((len(SMOOTH.vertices), 3))
# 8 bits, in sRGB for colours
CLOSE = {"base_color": 6e-3, "radiance": 2e-2}


def saved(folder, shapes):
    jd.save_gltf(folder / "a.glb", shapes)
    return jd.load_gltf(folder / "a.glb", width=4)


def header(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


BSDFS = {
    "constants": jd.Principled((0.123456, 0.5, 0.75), 0.3, 0.4, 0.2),
    "no specular": jd.Principled(0.5, 0.1, 0.2, 0.0),
    "most specular": jd.Principled(0.5, 0.1, 0.2, 1.0),
    "images": jd.Principled(jd.Bitmap(PICTURE, wrap=("clamp", "mirror")), jd.Bitmap(NUMBERS), jd.Bitmap(NUMBERS**2)),
    "colours": jd.Principled(jd.VertexColors(COLORS), 0.0, 0.5),
    "product": jd.Principled(jd.Product(jd.Bitmap(PICTURE), jd.VertexColors(COLORS)), 0.0, 0.5),
    "normals": jd.NormalMap(jd.Bitmap(0.4 + 0.2 * PICTURE), jd.Principled(0.5)),
    "holes": jd.Mask(0.25, jd.Principled(0.5)),
    "image of holes": jd.Mask(jd.Bitmap(NUMBERS), jd.Principled(jd.Bitmap(PICTURE))),
    "two sides": jd.TwoSided(jd.Principled(0.5)),
}


@pytest.mark.parametrize("name", BSDFS)
def test_a_material_is_read_as_it_was_written(tmp_path, name):
    shape = jd.Shape(SMOOTH, BSDFS[name])
    found = saved(tmp_path, {"ball": shape}).shapes["ball"]
    assert type(found.bsdf) is type(shape.bsdf)
    scenes = [jd.Scene({"ball": s}, jd.Orthographic(np.eye(4), jd.Film(2, 2))) for s in (shape, found)]
    one, other = (
        {key: value for key, value in scene.parameters().items() if key.startswith("ball.bsdf")} for scene in scenes
    )
    assert one.keys() == other.keys()
    for key, value in one.items():
        field = key.split(".")[2 if "bsdf.bsdf" not in key else 3]
        tolerance = CLOSE.get(field, 3e-3) if key.endswith("pixels") else 1e-6
        if key.endswith("colors"):
            continue  # below: the vertices of the file are others
        np.testing.assert_allclose(other[key], value, atol=tolerance, err_msg=key)
    for written, read in zip(_images(shape), _images(found), strict=True):
        assert (written.filter, written.wrap) == (read.filter, read.wrap)


def test_one_image_holds_metallic_and_roughness(tmp_path):
    """So a constant of one of them becomes an image as well."""
    shape = jd.Shape(SMOOTH, jd.Principled(0.3, 0.6, jd.Bitmap(NUMBERS, filter="nearest")))
    bsdf = saved(tmp_path, {"ball": shape}).shapes["ball"].bsdf
    np.testing.assert_allclose(bsdf.metallic.pixels, 0.6, atol=1e-6)
    np.testing.assert_allclose(bsdf.roughness.pixels[..., 0], NUMBERS, atol=3e-3)
    assert bsdf.roughness.filter == "nearest"


def _images(shape):
    leaves = jax.tree.leaves(unwrap(shape.bsdf), is_leaf=lambda leaf: isinstance(leaf, jd.Bitmap))
    return [leaf for leaf in leaves if isinstance(leaf, jd.Bitmap)]


def test_the_mesh_and_colours_of_its_vertices(tmp_path):
    found = saved(tmp_path, {"ball": jd.Shape(SMOOTH, BSDFS["colours"])}).shapes["ball"]
    mesh, colors = found.mesh, np.asarray(found.bsdf.base_color.colors)
    assert mesh.closed and mesh.normal_group_count == SMOOTH.normal_group_count

    def corners(mesh, colors):
        faces, columns = np.asarray(mesh.faces), [np.asarray(mesh.vertices), np.asarray(colors, np.float32)]
        uvs = np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)]
        rows = np.concatenate([column[faces] for column in columns] + [uvs], -1).reshape(-1, 8)
        return rows[np.lexsort(rows.T[:3])]

    np.testing.assert_allclose(
        np.sort(corners(mesh, colors), axis=0), np.sort(corners(SMOOTH, COLORS), axis=0), atol=1e-6
    )


@pytest.mark.parametrize("radiance", [0.0, 0.5, (3.0, 200.0, 1.0), jd.Bitmap(7 * PICTURE)])
def test_light(tmp_path, radiance):
    shape = jd.Shape(SMOOTH, jd.Principled(0.0), jd.AreaEmitter(radiance))
    found = saved(tmp_path, {"lamp": shape}).shapes["lamp"].emitter
    if isinstance(radiance, jd.Bitmap):
        np.testing.assert_allclose(found.radiance.pixels, radiance.pixels, atol=7 * 6e-3)
    elif radiance == 0.0:
        assert found is None
    else:
        np.testing.assert_allclose(found.radiance, np.ones(3) * radiance, rtol=1e-6)


def test_a_diffuse_shape_is_rough_and_not_specular(tmp_path):
    flat = jd.shapes.box()
    scene = saved(tmp_path, {"a": jd.Shape(flat, jd.Diffuse(0.2)), "b": jd.Shape(SMOOTH, jd.TwoSided(jd.Diffuse(0.3)))})
    assert list(scene.shapes) == ["a", "b"] and scene.shapes["a"].mesh.normal_faces is None
    for name, reflectance in (("a", 0.2), ("b", 0.3)):
        bsdf = unwrap(scene.shapes[name].bsdf)
        np.testing.assert_allclose(bsdf.base_color, [reflectance] * 3, rtol=1e-6)
        assert [float(v) for v in (bsdf.metallic, bsdf.roughness, bsdf.specular)] == [0, 1, 0]
    assert "textures" not in header(tmp_path / "a.glb")


def test_what_a_file_has_is_written_again(tmp_path):
    first = saved(tmp_path, {"ball": jd.Shape(SMOOTH, BSDFS["images"])})
    before = first.parameters()
    again = saved(tmp_path, first.shapes).parameters()
    for name in (name for name in before if name.startswith("ball.bsdf")):
        np.testing.assert_allclose(again[name], before[name], atol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("bsdf", "message"),
    [
        (jd.Plastic(), "ball.bsdf: glTF can't hold a Plastic; take a Principled or Diffuse"),
        (jd.Principled(sheen=0.5), r"ball\.bsdf\.sheen: glTF can't hold a lobe that glTF lacks; set it to 0 or None"),
        (jd.Principled(specular=jd.Bitmap(NUMBERS)), r"ball\.bsdf\.specular: .* a texture of it; give a number"),
        (jd.Principled(jd.Checkerboard(0.1, 0.2)), r"base_color: .* a Checkerboard of it; give a Bitmap, or VertexCol"),
        (jd.Principled(0.5, roughness=jd.VertexColors(COLORS[:, 0])), "a VertexColors of it; give a Bitmap$"),
        (jd.Principled(jd.Bitmap(PICTURE, to_uv=np.eye(3))), r"base_color: .* a to_uv of its texture; map the uvs"),
        (jd.Principled(jd.Product(jd.Bitmap(PICTURE), jd.Bitmap(PICTURE))), "a product of two images; multiply"),
        (jd.Principled(0.5, jd.Bitmap(NUMBERS), jd.Bitmap(NUMBERS[:2])), "roughness: .* another size or look-up than"),
        (jd.Mask(jd.Bitmap(NUMBERS[:2]), jd.Principled(jd.Bitmap(PICTURE))), "opacity: .* another size or look-up"),
    ],
)
def test_what_gltf_cannot_hold(tmp_path, bsdf, message):
    with pytest.raises(ValueError, match=message):
        jd.save_gltf(tmp_path / "a.glb", {"ball": jd.Shape(SMOOTH, bsdf)})
    assert list(tmp_path.iterdir()) == []


def test_light_through_holes_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"ball\.emitter: glTF can't hold light of a surface with holes"):
        jd.save_gltf(tmp_path / "a.glb", {"ball": jd.Shape(SMOOTH, BSDFS["holes"], jd.AreaEmitter(1.0))})


@pytest.mark.parametrize(
    ("name", "shapes", "message"),
    [
        ("a.gltf", {"a": jd.Shape(SMOOTH)}, r"a\.gltf must end with \.glb"),
        ("none/a.glb", {"a": jd.Shape(SMOOTH)}, "save_gltf: there is no folder"),
        ("a.glb", {}, "shapes is empty; give at least one"),
    ],
)
def test_wrong_arguments(tmp_path, name, shapes, message):
    with pytest.raises(ValueError, match=message):
        jd.save_gltf(tmp_path / name, shapes)


def test_an_earlier_file_stays_if_writing_fails(tmp_path, monkeypatch):
    (tmp_path / "a.glb").write_bytes(b"earlier")
    monkeypatch.setattr("os.replace", lambda *paths: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    for write in (
        lambda: jd.save_gltf(tmp_path / "a.glb", {"a": jd.Shape(SMOOTH)}),
        lambda: jd.save_mesh(tmp_path / "a.glb", SMOOTH),
    ):
        with pytest.raises(OSError, match="No space left"):
            write()
        assert [path.name for path in tmp_path.iterdir()] == ["a.glb"]
        assert (tmp_path / "a.glb").read_bytes() == b"earlier"
