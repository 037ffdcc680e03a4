"""Scene files of Mitsuba 0.x: what Mitsuba 3 makes of them."""

import warnings

import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.formats.mitsuba.upgrade import snake_case

OLD = """<?xml version="1.0" encoding="utf-8"?>
<scene version="0.6.0">
<integrator type="path"><integer name="maxDepth" value="65"/></integrator>
<sensor type="perspective"><string name="fovAxis" value="smaller"/><float name="nearClip" value="0.1"/>
    <float name="fov" value="40"/><float name="focusDistance" value="6"/>
    <transform name="toWorld"><lookAt origin="1, -4, 2" target="0, 0, 0.5" up="0, 0, 1"/></transform>
    <sampler type="independent"><integer name="sampleCount" value="16"/></sampler>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/>
        <string name="pixelFormat" value="RGB"/><string name="fileFormat" value="openEXR"/>
        <boolean name="banner" value="false"/><rfilter type="tent"/></film></sensor>
<texture type="checkerboard" id="board"><float name="uoffset" value="0.1"/><float name="uscale" value="2"/>
    <float name="vscale" value="3"/></texture>
<bsdf type="diffuse" id="paint"><rgb name="diffuseReflectance" value="0.5, 0.4, 0.3"/></bsdf>
<bsdf type="roughplastic" id="lacquer"><string name="distribution" value="ggx"/><float name="alpha" value="0.2"/>
    <float name="intIOR" value="1.6"/><float name="extIOR" value="1"/>
    <rgb name="diffuseReflectance" value="0.2, 0.3, 0.4"/></bsdf>
<shape type="cube" id="a"><transform name="toWorld"><scale value="0.5"/></transform><ref id="paint"/></shape>
<shape type="rectangle" id="b"><boolean name="flipNormals" value="true"/>
    <bsdf type="diffuse"><ref name="reflectance" id="board"/></bsdf></shape>
<shape type="cube" id="c"><ref id="lacquer"/></shape>
</scene>"""


def test_names():
    """As Mitsuba 3.9 renames them."""
    names = {"aBC": "a_bc", "ABc": "ABc", "fooBARBaz": "foo_barbaz", "fooB3x": "foo_b3x", "intIOR": "int_ior"}
    assert {name: snake_case(name) for name in names} == names


def test_an_old_file_is_read_as_a_new_one(tmp_path):
    path = tmp_path / "old.xml"
    path.write_text(OLD)
    scene = load_mitsuba(path)
    assert (scene.camera.film.width, scene.camera.film.height) == (8, 6)
    np.testing.assert_allclose(scene.camera.near_clip, 0.1)
    found = scene.parameters()
    np.testing.assert_allclose(found["a.bsdf.reflectance"], [0.5, 0.4, 0.3])
    np.testing.assert_allclose(found["c.bsdf.diffuse_reflectance"], [0.2, 0.3, 0.4])
    np.testing.assert_allclose(np.abs(scene.shapes["a"].mesh.vertices), 0.5)
    new = tmp_path / "new.xml"
    steps = '<transform name="to_uv"><translate x="0.1"/><scale x="2" y="3"/></transform>'
    new.write_text(
        f"""<scene version="3.0.0"><sensor type="perspective"/><shape type="rectangle" id="b">
        <boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><texture type="checkerboard" name="reflectance">{steps}</texture></bsdf></shape></scene>"""
    )
    expected = load_mitsuba(new).shapes["b"]
    np.testing.assert_array_equal(scene.shapes["b"].mesh.faces, expected.mesh.faces)
    np.testing.assert_allclose(scene.shapes["b"].bsdf.reflectance.to_uv, expected.bsdf.reflectance.to_uv)


def test_newer_files_are_not_renamed(load):
    with pytest.raises(ValueError, match="unknown parameter 'nearClip' of sensor 'perspective'; did you mean 'near_c"):
        load('<sensor type="perspective"><float name="nearClip" value="1"/></sensor><shape type="cube"/>')


def test_each_file_has_its_own_version(tmp_path):
    (tmp_path / "part.xml").write_text(
        '<scene version="0.5.0"><shape type="cube" id="c"><boolean name="flipNormals" value="true"/></shape></scene>'
    )
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><include filename="part.xml"/><sensor type="perspective"><float name="near_clip" '
        'value="1"/></sensor></scene>'
    )
    scene = jd.load_mitsuba(path)
    assert float(scene.camera.near_clip) == 1 and list(scene.shapes) == ["c"]


def test_mistakes_keep_their_place(tmp_path):
    path = tmp_path / "old.xml"
    path.write_text(OLD.replace("focusDistance", "focusDistnace").replace("intIOR", "innerIOR"))
    with pytest.raises(ValueError) as caught:
        load_mitsuba(path)
    assert "line 5, <float>: unknown parameter 'focus_distnace' of sensor 'perspective'; did you" in str(caught.value)
    assert "line 15, <float>: unknown parameter 'inner_ior'" in str(caught.value)


def test_as_mitsuba_reads_it(tmp_path):
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    path = tmp_path / "old.xml"
    path.write_text(OLD.replace("lookAt", "lookat"))  # Mitsuba 3 no longer takes the other
    try:
        theirs = mi.load_file(str(path))
        expected = np.array(theirs.sensors()[0].world_transform().matrix)
        bsdf = mi.traverse(theirs)
        (to_uv,) = [np.array(bsdf[k].matrix) for k in bsdf.keys() if k.endswith("to_uv")]
        expected_ior = [bsdf[k] for k in bsdf.keys() if k.endswith("eta")]
    finally:
        if before is not None:
            mi.set_variant(before)
    scene = load_mitsuba(path)
    np.testing.assert_allclose(scene.camera.to_world, expected, atol=1e-6)
    ours = np.vstack([scene.shapes["b"].bsdf.reflectance.to_uv, [0, 0, 1]])
    turned = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])  # Mitsuba counts v from the top
    np.testing.assert_allclose(turned @ ours @ turned, to_uv, atol=1e-6)
    np.testing.assert_allclose(expected_ior, [1.6], rtol=1e-6)


BALL = '<shape type="sphere" id="s"><bsdf type="{}">{}</bsdf></shape>'


@pytest.fixture
def old_bsdf(tmp_path):
    """The BSDF of a shape in a file of Mitsuba 0.6; any warning is an error unless `match` says what it is of."""

    def load_one(kind, content, match=None, **options):
        path = tmp_path / "old.xml"
        path.write_text(f'<scene version="0.6.0"><sensor type="perspective"/>{BALL.format(kind, content)}</scene>')
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if match is None:
                return load_mitsuba(path, **options).shapes["s"].bsdf
        with pytest.warns(UserWarning, match=match):
            return load_mitsuba(path, **options).shapes["s"].bsdf

    return load_one


REFLECTANCES = {
    '<srgb name="reflectance" value="0.5, 0.2, 1"/>': [0.21404114, 0.03310477, 1],
    '<srgb name="reflectance" value="#8033ff"/>': [0.21586050, 0.03310477, 1],
    '<rgb name="reflectance" value="#8033ff"/>': [128 / 255, 0.2, 1],
    '<spectrum name="reflectance" value="0.5 0.4 0.3"/>': [0.5, 0.4, 0.3],
    '<spectrum name="reflectance" value="0.3"/>': [0.3, 0.3, 0.3],
    '<spectrum name="reflectance" value="#8033ff"/>': [128 / 255, 0.2, 1],
}


@pytest.mark.parametrize("content, expected", REFLECTANCES.items(), ids=REFLECTANCES)
def test_colours(old_bsdf, content, expected):
    np.testing.assert_allclose(old_bsdf("diffuse", content).reflectance, expected, rtol=1e-6)


def test_colours_up_to_255_are_a_guess(old_bsdf):
    content = '<rgb name="reflectance" value="51, 102, 255"/>'
    with pytest.raises(
        ValueError, match=r"<rgb>: colour \[51.0, 102.0, 255.0\] is above 1; with ignore_unsupported it is"
    ):
        old_bsdf("diffuse", content)
    bsdf = old_bsdf("diffuse", content, "is above 1", ignore_unsupported=True)
    np.testing.assert_allclose(bsdf.reflectance, [0.2, 0.4, 1], rtol=1e-6)


def test_opacity_as_a_colour(old_bsdf):
    opacity = old_bsdf("mask", '<rgb name="opacity" value="0.25"/><bsdf type="diffuse"/>').opacity
    np.testing.assert_allclose(opacity, 0.25, rtol=1e-6)


INDICES = '<rgb name="eta" value="0.2, 0.9, 1.1"/><rgb name="k" value="3.9, 2.4, 2.2"/>'


@pytest.mark.parametrize("around", ['float name="extEta" value="1"', 'string name="extEta" value="air"'])
def test_metals_in_air(old_bsdf, around):
    np.testing.assert_allclose(old_bsdf("conductor", f"{INDICES}<{around}/>").eta, [0.2, 0.9, 1.1], rtol=1e-6)


def test_metals_in_something_else(old_bsdf):
    """Only the ratio of the indices counts."""
    metal = old_bsdf("conductor", f'{INDICES}<float name="extEta" value="1.25"/>')
    np.testing.assert_allclose(metal.eta, np.array([0.2, 0.9, 1.1]) / 1.25, rtol=1e-6)
    np.testing.assert_allclose(metal.k, np.array([3.9, 2.4, 2.2]) / 1.25, rtol=1e-6)
    with pytest.raises(ValueError, match="unknown parameter 'ext_eta' of bsdf 'conductor'; known: "):
        old_bsdf("conductor", '<string name="material" value="Au"/><float name="extEta" value="1.25"/>')


def test_metals_without_a_material(old_bsdf):
    old_bsdf("roughconductor", "", "perfect mirror, as in Mitsuba 3; in Mitsuba 0.x it is copper")


def test_images(old_bsdf, tmp_path):
    Image.fromarray(np.full((2, 2, 3), 128, np.uint8)).save(tmp_path / "p.bmp")
    texture = '<texture type="bitmap" name="reflectance"><string name="filename" value="p.bmp"/>{}</texture>'
    filtered = texture.format('<string name="filterType" value="trilinear"/><float name="maxAnisotropy" value="9"/>')
    image = old_bsdf("diffuse", filtered, "'trilinear' counts as bilinear").reflectance
    np.testing.assert_allclose(image.pixels, 0.2158605, rtol=1e-5)
    raw = old_bsdf("diffuse", texture.format('<float name="gamma" value="1.0"/>')).reflectance
    np.testing.assert_allclose(raw.pixels, 128 / 255, rtol=1e-6)
    old_bsdf("diffuse", texture.format('<float name="gamma" value="2.2"/>'), "gamma 2.2 counts as sRGB")
    old_bsdf("diffuse", texture.format('<float name="gamma" value="-1"/>'))
    with pytest.raises(ValueError, match="unknown parameter 'gamma'"):
        old_bsdf("diffuse", texture.format('<float name="gamma" value="1.8"/>'))
