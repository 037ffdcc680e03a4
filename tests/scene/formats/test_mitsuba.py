"""Meaning of scene files: shapes, BSDFs, emitters, camera and film."""

from pathlib import Path

import numpy as np
import pytest

from jaxdr.scene.bsdf import Diffuse, TwoSided
from jaxdr.scene.camera import Orthographic, ThinLens
from jaxdr.scene.film import Box, Gaussian, Tent
from jaxdr.scene.formats.mitsuba.load import load_mitsuba

REFERENCE_SCENES = Path(__file__).parents[3] / "experiments/data/reference_scenes"
SENSOR = '<sensor type="perspective"><float name="fov" value="40"/></sensor>'


@pytest.mark.parametrize(
    "name, shapes, film",
    [
        ("direct_spot", ["spot", "floor", "light"], (64, 64)),
        ("shadow_goathead", ["goathead", "floor", "light"], (64, 64)),
        ("cornell_indirect", ["back", "ceiling", "floor", "greenwall", "redwall", "spot", "luminaire"], (32, 32)),
        ("cube_constant", ["cube"], (64, 64)),
    ],
)
def test_reference_scenes(name, shapes, film):
    scene = load_mitsuba(REFERENCE_SCENES / name / "scene.xml")
    assert set(scene.shapes) == set(shapes)
    assert (scene.camera.film.width, scene.camera.film.height) == film and scene.camera.film.filter == Gaussian(0.5)
    assert all(shape.mesh.normal_faces is None for shape in scene.shapes.values())
    assert (scene.environment is None) == (name != "cube_constant")
    if name == "cornell_indirect":
        spot = np.asarray(scene.shapes["spot"].mesh.vertices)
        assert spot.min() > 0 and spot.max() < 1  # placed inside the box by its to_world
        assert isinstance(scene.shapes["luminaire"].bsdf, TwoSided)
        assert np.allclose(scene.parameters()["luminaire.emitter.radiance"], [14, 12, 9])


# BSDFs and emitters


def reflectance(load_shape, content):
    return np.asarray(load_shape(f'<shape type="cube">{content}</shape>').bsdf.reflectance).tolist()


def test_diffuse(load_shape):
    for color, expected in {
        '<rgb name="reflectance" value="0.25, 0.5, 0.75"/>': [0.25, 0.5, 0.75],
        '<spectrum name="reflectance" value="0.25"/>': [0.25] * 3,
        '<float name="reflectance" value="0.25"/>': [0.25] * 3,
        "": [0.5] * 3,
    }.items():
        assert reflectance(load_shape, f'<bsdf type="diffuse">{color}</bsdf>') == expected


def test_default_bsdf_is_grey_and_that_of_a_light_black(load_shape):
    assert reflectance(load_shape, "") == [0.5] * 3
    assert reflectance(load_shape, '<emitter type="area"/>') == [0.0] * 3


def test_references_and_twosided(load):
    scene = load(
        SENSOR
        + """<shape type="cube" id="a"><ref id="late"/></shape>
        <bsdf type="twosided" id="late"><ref id="grey"/></bsdf>
        <bsdf type="diffuse" id="grey"><float name="reflectance" value="0.25"/></bsdf>
        <shape type="cube" id="b"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
        <shape type="cube" id="c"><ref id="grey" name="bsdf"/></shape>"""
    )
    assert [type(scene.shapes[name].bsdf) for name in "abc"] == [TwoSided, TwoSided, Diffuse]
    values = {name: float(scene.parameters()[f"{name}.bsdf.reflectance"][0]) for name in "abc"}
    assert values == {"a": 0.25, "b": 0.5, "c": 0.25}


def test_emitters(load):
    def radiance(value):
        scene = load(
            SENSOR + f'<shape type="cube" id="l"><emitter type="area">{value}</emitter></shape>'
            f'<emitter type="constant" id="sky">{value}</emitter>'
        )
        area, sky = (np.asarray(scene.parameters()[f"{n}.radiance"]) for n in ("l.emitter", "environment"))
        assert np.array_equal(area, sky)
        return area

    assert np.array_equal(radiance('<rgb name="radiance" value="1, 2, 3"/>'), [1, 2, 3])
    assert np.array_equal(radiance('<float name="radiance" value="2"/>'), [2, 2, 2])
    assert np.array_equal(radiance(""), [1, 1, 1])
    # Rows of the XYZ to linear sRGB matrix, summed: what the flat spectrum looks like as a light.
    flat = [3.240479 - 1.537150 - 0.498535, -0.969256 + 1.875991 + 0.041556, 0.055648 - 0.204043 + 1.057311]
    np.testing.assert_allclose(radiance('<spectrum name="radiance" value="2"/>'), 2 * np.array(flat), rtol=1e-5)


# Camera and film


def load_camera(load, content="", film=""):
    sensor = f'<sensor type="perspective" id="any">{content}<film type="hdrfilm">{film}</film></sensor>'
    return load(sensor + '<shape type="cube"/>').camera


def test_camera(load):
    camera = load_camera(
        load,
        '<float name="fov" value="30"/><string name="fov_axis" value="smaller"/><float name="near_clip" value="0.5"/>'
        '<float name="far_clip" value="50"/><float name="principal_point_offset_x" value="0.1"/>'
        '<transform name="to_world"><lookat origin="1, 2, 3" target="1, 2, 4" up="0, 1, 0"/></transform>'
        '<sampler type="independent"><integer name="sample_count" value="16"/></sampler>',
    )
    assert (float(camera.fov), camera.fov_axis, camera.near_clip, camera.far_clip) == (30, "smaller", 0.5, 50)
    np.testing.assert_allclose(camera.principal_point, [0.1, 0])
    assert np.array_equal(camera.to_world, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


def test_camera_defaults(load):
    camera = load_camera(load)
    assert np.array_equal(camera.to_world, np.eye(4)) and (camera.near_clip, camera.far_clip) == (1e-2, 1e4)
    assert (camera.film.width, camera.film.height, camera.film.filter, camera.film.crop) == (768, 576, Gaussian(), None)
    assert load_camera(load, '<float name="fov" value="20"/>').fov_axis == "x"
    # 50 mm on a 36 x 24 mm film, so 18 mm to the side.
    film = '<integer name="width" value="36"/><integer name="height" value="24"/>'
    for focal_length, millimetres in {"": 50, '<string name="focal_length" value="20mm"/>': 20}.items():
        camera = load_camera(load, focal_length, film)
        np.testing.assert_allclose(camera.pixels_per_tangent, millimetres, rtol=1e-5)


def load_sensor(load, kind, content):
    return load(f'<sensor type="{kind}">{content}</sensor><shape type="cube"/>').camera


def test_thin_lens(load):
    lens = '<float name="aperture_radius" value="0.1"/>'
    camera = load_sensor(load, "thinlens", f'<float name="fov" value="30"/><float name="far_clip" value="70"/>{lens}')
    assert isinstance(camera, ThinLens) and camera.principal_point.tolist() == [0, 0]
    np.testing.assert_allclose([camera.fov, camera.aperture_radius, camera.focus_distance], [30, 0.1, 70], rtol=1e-6)
    assert load_sensor(load, "thinlens", f'{lens}<float name="focus_distance" value="3"/>').focus_distance == 3


def test_orthographic(load):
    content = '<float name="near_clip" value="0.5"/><transform name="to_world"><scale x="2" y="3"/></transform>'
    camera = load_sensor(load, "orthographic", content)
    assert isinstance(camera, Orthographic) and (camera.near_clip, camera.far_clip) == (0.5, 1e4)
    assert np.array_equal(camera.to_world, np.diag([2, 3, 1, 1]))


def test_film(load):
    film = load_camera(
        load,
        film='<integer name="width" value="40"/><integer name="height" value="30"/>'
        '<integer name="crop_offset_x" value="3"/><integer name="crop_offset_y" value="4"/>'
        '<integer name="crop_width" value="20"/><integer name="crop_height" value="10"/>'
        '<string name="pixel_format" value="rgba"/><string name="component_format" value="float32"/>'
        '<string name="file_format" value="openexr"/><boolean name="sample_border" value="true"/>',
    ).film
    assert (film.width, film.height, film.crop) == (40, 30, (3, 4, 20, 10))


@pytest.mark.parametrize(
    "rfilter, expected",
    [
        ('type="box"/>', Box()),
        ('type="gaussian"/>', Gaussian(0.5)),
        ('type="gaussian"><float name="stddev" value="0.7"/></rfilter>', Gaussian(0.7)),
        ('type="tent"/>', Tent(1.0)),
        ('type="tent"><float name="radius" value="2"/></rfilter>', Tent(2.0)),
    ],
)
def test_filters(load, rfilter, expected):
    assert load_camera(load, film=f"<rfilter {rfilter}").film.filter == expected


# The whole file


def test_variables(load):
    text = (
        '<default name="size" value="8"/><sensor type="perspective"><film type="hdrfilm">'
        '<integer name="width" value="$size"/><integer name="height" value="$height"/></film></sensor>'
        '<shape type="$kind"/>'
    )
    film = load(text, height=5, kind="cube").camera.film
    assert (film.width, film.height) == (8, 5)
    assert load(text, size=7, height=5, kind="cube").camera.film.width == 7
    with pytest.raises(ValueError, match=r"scene.xml, line 2, <integer>: variable \$height has no value"):
        load(text, kind="cube")
    with pytest.raises(ValueError, match=r"scene.xml, line 1, <scene>: nothing in this scene uses the variable spp"):
        load(text, height=5, kind="cube", spp=3)


def test_included_material_and_sensor(load, tmp_path):
    (tmp_path / "sensor.xml").write_text(f'<scene version="3.0.0">{SENSOR}</scene>')
    (tmp_path / "grey.xml").write_text('<bsdf version="3.0.0" type="diffuse" id="grey"/>')
    scene = load(
        '<include filename="sensor.xml"/><include filename="grey.xml"/><shape type="cube"><ref id="grey"/></shape>'
    )
    assert float(scene.camera.fov) == 40 and isinstance(scene.shapes["cube"].bsdf, Diffuse)


@pytest.mark.parametrize("kind", ["path", "direct_projective"])
def test_integrators_are_accepted(load, kind):
    integrator = f'<integrator type="{kind}"><integer name="max_depth" value="3"/></integrator>'
    assert list(load(integrator + SENSOR + '<shape type="cube"/>').shapes) == ["cube"]


CUBE = '<shape type="cube">%s</shape>'
ERRORS = {
    "no sensor": (CUBE % "", "1, <scene>: the scene has no <sensor>"),
    "no shape": (SENSOR, "1, <scene>: the scene has no <shape> that can be seen"),
    "two sensors": (f"{SENSOR}\n{SENSOR}", "3, <sensor>: the scene has several sensors"),
    "two environments": (f'{SENSOR}<emitter type="constant"/>\n<emitter type="constant"/>', "3, <emitter>: a second"),
    "unknown element": (
        '<volume type="grid"/>',
        "2, <volume>: participating media are not supported; with ignore_unsupported it is left out",
    ),
    "unknown shape": (
        '<shape type="hair"/>',
        "2, <shape>: unknown type 'hair'; known: obj, ply, serialized, rectangle",
    ),
    "unknown bsdf": (CUBE % '\n<bsdf type="hair"/>', "3, <bsdf>: unknown type 'hair'; known: diffuse, twosided"),
    "unused unknown bsdf": ('<bsdf type="hair" id="p"/>', "2, <bsdf>: unknown type 'hair'"),
    "unknown emitter": ('<emitter type="glow"/>', "2, <emitter>: unknown type 'glow'; known: constant"),
    "sky": ('<emitter type="sunsky"/>', "2, <emitter>: unknown type 'sunsky'; .*write the sky into an image and give"),
    "unknown sensor": ('<sensor type="fisheye"/>', "2, <sensor>: unknown type 'fisheye'; known: perspective, thinlens"),
    "unknown integrator": ('<integrator type="stokes"/>', "2, <integrator>: unknown type 'stokes'; known: path, "),
    "hidden emitters": (
        '<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator>',
        "2, <integrator>: hide_emitters is not supported",
    ),
    "scene parameter": ('<float name="spp" value="3"/>', "2, <float>: unknown parameter 'spp' of scene 'scene'"),
    "shape parameter": (CUBE % '\n<float name="size" value="3"/>', "3, <float>: unknown parameter 'size' of shape"),
    "sphere face normals": (
        '<shape type="sphere"><boolean name="face_normals" value="true"/></shape>',
        "2, <boolean>: unknown parameter 'face_normals' of shape 'sphere'",
    ),
    "radius": ('<shape type="sphere"><float name="radius" value="0"/></shape>', "2, <shape>: radius must be"),
    "flattened": (
        CUBE % '<transform name="to_world"><scale x="0"/></transform>',
        "2, <shape>: to_world has no inverse",
    ),
    "same id": ('<bsdf type="diffuse" id="a"/>\n<shape type="cube" id="a"/>', "3, <shape>: id 'a' is taken by <bsdf>"),
    "dotted id": ('<shape type="cube" id="a.b"/>', "2, <shape>: id 'a.b' can't name a shape"),
    "reserved id": ('<shape type="cube" id="camera"/>', "2, <shape>: id 'camera' can't name a shape"),
    "no filename": ('<shape type="obj"/>', "2, <shape>: parameter 'filename' is missing"),
    "missing mesh": ('<shape type="obj"><string name="filename" value="no.obj"/></shape>', "2, <shape>: .*no.obj"),
    "other format": ('<shape type="obj"><string name="filename" value="a.ply"/></shape>', "2, <shape>: a.ply is not a"),
    "two bsdfs": (CUBE % '<bsdf type="diffuse"/>\n<bsdf type="diffuse"/>', "3, <bsdf>: a second one in one <shape>"),
    "reference to nothing": (CUBE % '\n<ref id="grey"/>', "3, <ref>: there is no object with id 'grey'"),
    "reference to a shape": ('<shape type="cube" id="c">\n<ref id="c"/></shape>', "3, <ref>: refers to 'c', which"),
    "reference in the scene": ('<ref id="a"/>', "2, <ref>: there is no object with id 'a'"),
    "reflectance": (
        CUBE % '<bsdf type="diffuse"><rgb name="reflectance" value="1, 2, 1"/></bsdf>',
        r"2, <bsdf>: reflectance must be in \[0, 1\], got \[1.0, 2.0, 1.0\]",
    ),
    "texture": (
        CUBE % '<bsdf type="diffuse">\n<texture type="bitmap"/></bsdf>',
        "3, <texture>: not supported inside bsdf 'diffuse'",
    ),
    "empty twosided": (CUBE % '\n<bsdf type="twosided"/>', "3, <bsdf>: needs a <bsdf> inside"),
    "twosided twice": (
        CUBE % '<bsdf type="twosided">\n<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>',
        "3, <bsdf>: the BSDF inside is two-sided already",
    ),
    "twosided cycle": ('<bsdf type="twosided" id="a"><ref id="a"/></bsdf>', "2, <ref>: refers to 'a', which"),
    "emitter parameter": (
        '<emitter type="constant"><float name="scale" value="2"/></emitter>',
        "2, <float>: unknown parameter 'scale' of emitter 'constant'",
    ),
}
SENSOR_ERRORS = {
    '<string name="fov_axis" value="w"/><float name="fov" value="30"/>': "<sensor>: Perspective: fov_axis must be",
    '<float name="fov" value="180"/>': "<sensor>: fov must be between 0 and 180 degrees, got 180",
    '<float name="fov" value="30"/><string name="focal_length" value="50mm"/>': "<sensor>: give either fov or focal",
    '<string name="focal_length" value="wide"/>': "<sensor>: expected numbers, got 'wide'",
    '<float name="near_clip" value="-1"/>': "<sensor>: Perspective: need 0 < near_clip",
    '<transform name="to_world"><scale value="2"/></transform>': "<sensor>: to_world must not scale or shear",
    '<float name="aperture" value="1"/>': "<float>: unknown parameter 'aperture' of sensor 'perspective'",
    '<film type="specfilm"/>': "<film>: unknown type 'specfilm'; known: hdrfilm",
    '<film type="hdrfilm"><integer name="width" value="0"/></film>': "<film>: width and height: expected 1 to",
    '<film type="hdrfilm"><integer name="crop_width" value="900"/></film>': "<film>: Film: crop",
    '<film type="hdrfilm"><integer name="crop_offset_x" value="1"/></film>': "<film>: Film: crop",
    '<film type="hdrfilm"><string name="pixel_format" value="xyz"/></film>': "<film>: pixel_format must be rgb or rgba",
    '<film type="hdrfilm"><float name="width" value="8"/></film>': "<float>: parameter 'width' must be given",
    '<film type="hdrfilm"><rfilter type="mitchell"/></film>': "<rfilter>: unknown type 'mitchell'; known: box",
    '<film type="hdrfilm"><rfilter type="box"><float name="radius" value="1"/></rfilter></film>': "<float>: unknown",
    '<film type="hdrfilm"><rfilter type="tent"><float name="radius" value="0"/></rfilter></film>': "<rfilter>: radius",
}
ERRORS |= {
    "no aperture": (f'{CUBE % ""}<sensor type="thinlens"/>', "2, <sensor>: aperture_radius is missing"),
    "closed aperture": (
        f'{CUBE % ""}<sensor type="thinlens"><float name="aperture_radius" value="0"/></sensor>',
        "2, <sensor>: ThinLens: aperture_radius must be a positive number, got 0.0; without an aperture take Persp",
    ),
    "lens off the axis": (
        f'{CUBE % ""}<sensor type="thinlens"><float name="aperture_radius" value="1"/>'
        '<float name="principal_point_offset_x" value="0.1"/></sensor>',
        "2, <float>: unknown parameter 'principal_point_offset_x' of sensor 'thinlens'",
    ),
    "orthographic with a field of view": (
        f'{CUBE % ""}<sensor type="orthographic"><float name="fov" value="30"/></sensor>',
        "2, <float>: unknown parameter 'fov' of sensor 'orthographic'",
    ),
    "flat orthographic": (
        f'{CUBE % ""}<sensor type="orthographic"><transform name="to_world"><scale x="0"/></transform></sensor>',
        "2, <sensor>: Orthographic: to_world can't be inverted",
    ),
}
ERRORS |= {
    text: (f'{CUBE % ""}<sensor type="perspective">{text}</sensor>', f"2, {message}")
    for text, message in SENSOR_ERRORS.items()
}


@pytest.mark.parametrize("content, message", ERRORS.values(), ids=ERRORS)
def test_errors_name_file_line_and_tag(load, content, message):
    whole = content if "sensor" in content or "scene has no" in message else SENSOR + content
    with pytest.raises(ValueError, match=r"scene.xml, line " + message):
        load(whole)


def test_outermost_element(tmp_path):
    path = tmp_path / "cube.xml"
    path.write_text('<shape version="3.0.0" type="cube"/>')
    with pytest.raises(ValueError, match=r"cube.xml, line 1, <shape>: the outermost element must be <scene>"):
        load_mitsuba(path)
