"""Texture plugins of Mitsuba scene files, and the BSDFs that are made of them."""

import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.textures import TEXTURES
from tests.scene.conftest import PLY, SENSOR

RGB = np.random.default_rng(0).integers(0, 256, (5, 6, 3), np.uint8)
GREY = np.random.default_rng(1).integers(0, 256, (5, 6), np.uint8)
COLOURED = PLY.replace("property float z\n", "property float z\nproperty float r\nproperty float g\nproperty float b\n")
COLOURS = ("0.1 0.2 0.3", "0.4 0.5 0.6", "0.7 0.8 0.9", "1 0 0.5")
for position, colour in zip(("-1 -1 0", "1 -1 0", "1 1 0.5", "-1 1 0"), COLOURS, strict=True):
    COLOURED = COLOURED.replace(f"{position}\n", f"{position} {colour}\n")
SPLIT = COLOURED.replace("vertex 4", "vertex 5").replace("3 0 1 2", "1 -1 0 0 0 1\n3 0 1 2").replace("3 0 1", "3 0 4")


@pytest.fixture
def material(load, tmp_path):
    """The BSDF of a cube, or of another shape, and its textures' files."""
    Image.fromarray(RGB).save(tmp_path / "rgb.png")
    Image.fromarray(GREY).save(tmp_path / "grey.png")
    for name, text in {"coloured.ply": COLOURED, "split.ply": SPLIT}.items():
        (tmp_path / name).write_text(text)

    def load_material(content, shape='<shape type="cube" id="s">', **options):
        return load(f"{SENSOR}{shape}{content}</shape>", **options).shapes["s"].bsdf

    return load_material


def bitmap(field, file="rgb.png", inside=""):
    return f'<texture type="bitmap" name="{field}"><string name="filename" value="{file}"/>{inside}</texture>'


def diffuse(inside):
    return f'<bsdf type="diffuse">{inside}</bsdf>'


def linear(stored):
    share = stored / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def test_bitmap(material):
    texture = material(diffuse(bitmap("reflectance"))).reflectance
    np.testing.assert_allclose(texture.pixels, linear(RGB), rtol=1e-5)
    assert (texture.filter, texture.wrap, texture.to_uv) == ("bilinear", "repeat", None)
    settings = (
        '<boolean name="raw" value="true"/><string name="filter_type" value="nearest"/><string name="wrap_mode" '
        'value="clamp"/><string name="format" value="fp16"/><boolean name="accel" value="false"/>'
    )
    texture = material(diffuse(bitmap("reflectance", "grey.png", settings))).reflectance
    np.testing.assert_allclose(texture.pixels, np.repeat(GREY[..., None] / 255, 3, -1), rtol=1e-6)
    assert (texture.filter, texture.wrap) == ("nearest", "clamp")


def test_to_uv_for_uvs_that_start_below(material):
    """Mitsuba's (u, w = 1 - v) -> (2 u + 0.25, 3 w + 0.5), and a quarter turn: v is turned over before and after."""
    place = '<transform name="to_uv"><scale x="2" y="3"/><translate x="0.25" y="0.5" z="7"/></transform>'
    texture = material(diffuse(bitmap("reflectance", inside=place))).reflectance
    np.testing.assert_allclose(texture.to_uv, [[2, 0, 0.25], [0, 3, 1 - 3 - 0.5]], atol=1e-6)
    turn = '<transform name="to_uv"><rotate z="1" angle="90"/></transform>'
    texture = material(diffuse(f'<texture type="checkerboard" name="reflectance">{turn}</texture>')).reflectance
    np.testing.assert_allclose(texture.to_uv, [[0, 1, -1], [-1, 0, 1]], atol=1e-6)


def test_checkerboard(material):
    texture = material(diffuse('<texture type="checkerboard" name="reflectance"/>')).reflectance
    np.testing.assert_allclose([texture.color0, texture.color1], [[0.4] * 3, [0.2] * 3], rtol=1e-6)
    inside = '<rgb name="color0" value="0.1, 0.2, 0.3"/><float name="color1" value="0.6"/>'
    board = f'<texture type="checkerboard" name="%s">{inside}</texture>'
    texture = material(diffuse(board % "reflectance")).reflectance
    np.testing.assert_allclose([texture.color0, texture.color1], [[0.1, 0.2, 0.3], [0.6] * 3], rtol=1e-6)
    alpha = material(f'<bsdf type="roughconductor">{board % "alpha"}</bsdf>').alpha
    grey = 0.2126 * 0.1 + 0.7152 * 0.2 + 0.0722 * 0.3  # the other way around: Mitsuba's numbers
    np.testing.assert_allclose([alpha.color0[0], alpha.color1[0]], [0.6, grey], rtol=1e-5)


def test_numbers_are_luminances(material):
    raw = '<boolean name="raw" value="true"/>'
    bsdf = material(f'<bsdf type="principled">{bitmap("roughness", inside=raw)}{bitmap("metallic", "grey.png")}</bsdf>')
    np.testing.assert_allclose(bsdf.roughness.pixels[..., 0], RGB / 255 @ [0.2126, 0.7152, 0.0722], rtol=1e-5)
    np.testing.assert_allclose(bsdf.metallic.pixels[..., 0], linear(GREY), rtol=1e-5)


def test_roughness_is_kept_in_range(material, tmp_path):
    Image.fromarray(np.array([[0, 128]], np.uint8)).save(tmp_path / "dark.png")
    alpha = material(f'<bsdf type="roughconductor">{bitmap("alpha", "dark.png")}</bsdf>').alpha
    np.testing.assert_allclose(alpha.pixels[0, :, 0], [1e-4, linear(128)], rtol=1e-5)


def test_every_material_takes_textures(material):
    image = bitmap("%s", "grey.png", '<boolean name="raw" value="true"/>')

    def made(kind, *fields):
        bsdf = material(f'<bsdf type="{kind}">{"".join(image % field for field in fields)}</bsdf>')
        return [isinstance(getattr(bsdf, field), jd.Bitmap) for field in fields]

    assert all(made("roughconductor", "alpha", "specular_reflectance", "eta", "k"))
    assert all(made("roughdielectric", "alpha", "specular_reflectance", "specular_transmittance"))
    assert all(made("roughplastic", "diffuse_reflectance", "specular_reflectance"))
    assert all(made("principled", "base_color", "metallic", "roughness", "specular"))


VERTEX_COLOR = '<texture type="mesh_attribute" name="reflectance"><string name="name" value="%s"/>%s</texture>'
SHAPE = '<shape type="ply" id="s"><string name="filename" value="%s"/>'


def test_vertex_colours(material):
    colours = [[float(x) for x in colour.split()] for colour in COLOURS]
    texture = material(diffuse(VERTEX_COLOR % ("vertex_color", "")), SHAPE % "coloured.ply").reflectance
    np.testing.assert_allclose(texture.colors, colours, rtol=1e-6)
    half = '<float name="scale" value="0.5"/>'
    nested = f'<bsdf type="twosided">{diffuse(VERTEX_COLOR % ("vertex_color", half))}</bsdf>'
    texture = material(nested, SHAPE % "coloured.ply").bsdf.reflectance
    np.testing.assert_allclose(texture.colors, 0.5 * np.array(colours), rtol=1e-6)


def test_values_of_faces(tmp_path):
    """As the loader of meshes hands them down."""
    name = Element("string", {"name": "name", "value": "face_heat"}, tmp_path, 1)
    data = {"vertex_color": None, "face_heat": np.array([[0.1], [0.4]])}
    texture = Element("texture", {"type": "mesh_attribute"}, tmp_path, 1, [name], vertex_data=data)
    found = TEXTURES["mesh_attribute"](texture)
    assert isinstance(found, jd.FaceColors)
    np.testing.assert_allclose(found.colors, [[0.1], [0.4]], rtol=1e-6)


def test_bump_maps_and_old_textures(material):
    """Colours become luminance; Mitsuba 0.x scales textures and has names of blurring filters."""
    old = '<string name="filter_type" value="trilinear"/>'
    inner = bitmap("", "rgb.png", RAW + old).replace('name=""', "")
    scaled = f'<texture type="scale"><float name="scale" value="0.5"/>{inner}</texture>'
    for texture, factor in ((inner, 1.0), (scaled, 0.5)):
        bump = material(f'<bsdf type="bumpmap"><float name="scale" value="3"/>{texture}{diffuse("")}</bsdf>')
        assert isinstance(bump, jd.BumpMap) and bump.scale == 3
        expected = factor * RGB / 255 @ [0.2126, 0.7152, 0.0722]
        np.testing.assert_allclose(bump.height.pixels[..., 0], expected, rtol=1e-5)


def test_textures_by_reference(load, material, tmp_path):
    """One texture, one BSDF for two meshes: each gets the colours of its own."""
    (tmp_path / "other.ply").write_text(COLOURED.replace("1 0 0.5", "0 1 0.5"))
    scene = load(
        f'{SENSOR}<texture type="mesh_attribute" id="t"><string name="name" value="vertex_color"/></texture>'
        '<bsdf type="diffuse" id="b"><ref name="reflectance" id="t"/></bsdf>'
        f'{SHAPE % "coloured.ply"}<ref id="b"/></shape>'
        '<shape type="ply" id="other"><string name="filename" value="other.ply"/><ref id="b"/></shape>'
    )
    colours = [scene.parameters()[f"{name}.bsdf.reflectance.colors"][3] for name in ("s", "other")]
    np.testing.assert_allclose(colours, [[1, 0, 0.5], [0, 1, 0.5]])


def test_area_emitters_take_textures(load, material, tmp_path):
    glow = ('<texture type="checkerboard" name="radiance"><rgb name="color0" value="5, 0, 1"/></texture>',
            bitmap("radiance", inside='<string name="wrap_mode" value="mirror"/>'),
            '<texture type="uniform" name="radiance"><float name="value" value="3"/></texture>',
            (VERTEX_COLOR % ("vertex_color", "")).replace("reflectance", "radiance"))  # fmt: skip
    assert material("") is not None  # writes the files
    found = []
    for inside, shape in zip(glow, (CUBE, CUBE, CUBE, SHAPE % "coloured.ply"), strict=True):
        of = load(f'{SENSOR}{shape}<emitter type="area">{inside}</emitter></shape>')
        found.append(of.shapes["s"].emitter.radiance)
    board, image, constant, colours = found
    np.testing.assert_allclose(board.color0, [5, 0, 1])
    np.testing.assert_allclose(board.color1, 0.2)
    np.testing.assert_allclose(image.pixels, linear(RGB), rtol=1e-5)
    assert image.wrap == "mirror" and constant.tolist() == [3, 3, 3]
    assert isinstance(colours, jd.VertexColors) and colours.colors.shape == (4, 3)


def test_mask_and_normal_map(material):
    inner = f'<bsdf type="roughconductor">{bitmap("alpha", "grey.png", RAW)}</bsdf>'
    mask = material(f'<bsdf type="mask">{bitmap("opacity", "grey.png", RAW)}{inner}</bsdf>')
    assert isinstance(mask, jd.Mask) and isinstance(mask.bsdf, jd.RoughConductor)
    np.testing.assert_allclose(mask.opacity.pixels[..., 0], GREY / 255, rtol=1e-6)
    mask = material('<bsdf type="mask"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>')
    assert isinstance(mask, jd.TwoSided) and isinstance(mask.bsdf, jd.Mask) and mask.bsdf.opacity == 0.5
    normal = material(f'<bsdf type="normalmap">{bitmap("normalmap", inside=RAW)}{inner}</bsdf>')
    assert isinstance(normal, jd.NormalMap) and isinstance(normal.bsdf, jd.RoughConductor)
    np.testing.assert_allclose(normal.normal.pixels, RGB / 255, rtol=1e-6)
    both = f'<bsdf type="normalmap">{bitmap("normalmap", inside=RAW)}<bsdf type="twosided">{inner}</bsdf></bsdf>'
    with pytest.warns(UserWarning, match="twosided inside a normalmap is not supported; put it around"):
        both = material(both, ignore_unsupported=True)
    assert isinstance(both, jd.TwoSided) and isinstance(both.bsdf, jd.NormalMap)


RAW = '<boolean name="raw" value="true"/>'
FLIP = '<boolean name="flip_invalid_normals" value="false"/>'
CUBE = '<shape type="cube" id="s">'
WRONG = [
    (diffuse(bitmap("reflectance", "no.png")), CUBE, "line 2, <texture>: there is no file .*no.png"),
    (diffuse('<texture type="bitmap" name="reflectance"/>'), CUBE, "<texture>: parameter 'filename' is missing"),
    (diffuse(bitmap("reflectance", inside='<string name="filter_type" value="x"/>')), CUBE, "filter must be one of"),
    (diffuse(bitmap("reflectance", inside='<string name="wrap_mode" value="x"/>')), CUBE, "wrap must be one of"),
    (diffuse(bitmap("reflectance", inside='<float name="gamma" value="2"/>')), CUBE, "unknown parameter 'gamma'"),
    (diffuse(VERTEX_COLOR % ("vertex_color", "")), CUBE, "the mesh has no attribute 'vertex_color'; it has: "),
    (diffuse(VERTEX_COLOR % ("face_color", "")), CUBE, "the mesh has no attribute 'face_color'; it has: "),
    (
        diffuse(VERTEX_COLOR % ("vertex_color", "")),
        SHAPE % "split.ply",
        "at the same position have different values of",
    ),
    (diffuse(bitmap("reflectance")), SHAPE % "a.ply", r"s\.bsdf\.reflectance, a Bitmap, needs texture coordinates"),
    (
        diffuse(VERTEX_COLOR % ("colour", "")),
        CUBE,
        "the name of an attribute starts with vertex_ or face_, got 'colour'",
    ),
    ('<bsdf type="mask"/>', CUBE, "needs a <bsdf> inside"),
    (f'<bsdf type="normalmap">{diffuse("")}</bsdf>', CUBE, "needs a <texture> named 'normalmap'"),
    (f'<bsdf type="normalmap">{FLIP}{diffuse("")}</bsdf>', CUBE, "flip_invalid_normals other than true"),
    (f'<bsdf type="roughplastic">{bitmap("int_ior")}</bsdf>', CUBE, "a texture can't give 'int_ior' here"),
    (f'<emitter type="area">{bitmap("radiance", "no.png")}</emitter>', CUBE, "there is no file .*no.png"),
    ('<emitter type="area"><rgb name="radiance" value="1, -1, 1"/></emitter>', CUBE, "radiance must be at least 0"),
    (f'<emitter type="area">{bitmap("radiance")}</emitter>', SHAPE % "a.ply", r"s\.emitter\.radiance, a Bitmap, needs"),
]


@pytest.mark.parametrize(("content", "shape", "message"), WRONG)
def test_what_is_refused(material, content, shape, message):
    with pytest.raises(ValueError, match=message):
        material(content, shape)
