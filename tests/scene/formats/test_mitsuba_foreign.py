"""What scenes of other people hold: objects by reference, settings of other programs, encodings, attributes of PLY."""

import warnings

import numpy as np
import pytest

from experiments.real_scenes.mitsuba_meshes import hill, ply
from jaxdr.scene.film import Box
from jaxdr.scene.formats.mitsuba.document import read_document
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.load import load_mitsuba

from ..conftest import SENSOR

CUBE = '<shape type="cube" id="c">%s</shape>'


@pytest.fixture
def mitsuba():
    module = pytest.importorskip("mitsuba")
    module.set_variant("scalar_rgb")
    return module


@pytest.fixture
def load_silently(load):
    """Load; any warning is an error."""

    def silently(content, **options):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return load(content, **options)

    return silently


def test_parts_of_a_sensor_and_emitters_by_reference(load_silently):
    scene = load_silently(
        """<rfilter type="box" id="f"/><sampler type="independent" id="s"/>
        <film type="hdrfilm" id="film"><integer name="width" value="7"/><ref id="f"/></film>
        <sensor type="perspective"><ref id="film"/><ref id="s"/></sensor>
        <emitter type="area" id="glow"><rgb name="radiance" value="1, 2, 3"/></emitter>"""
        + CUBE % '<ref id="glow"/>'
    )
    assert scene.camera.film.width == 7 and scene.camera.film.filter == Box()
    np.testing.assert_array_equal(scene.shapes["c"].emitter.radiance, [1, 2, 3])
    np.testing.assert_array_equal(scene.shapes["c"].bsdf.reflectance, [0, 0, 0])


@pytest.mark.parametrize(
    "part",
    ['<emitter type="area"/>', '<sampler type="independent"/>', '<film type="hdrfilm"/>', '<rfilter type="box"/>'],
)
def test_what_nothing_refers_to_has_no_effect_and_is_named(load, part):
    with pytest.warns(UserWarning, match=r"line 3, <\w+>: nothing refers to it: it has no effect"):
        scene = load(SENSOR + "\n" + part + CUBE % "")
    assert scene.shapes["c"].emitter is None and scene.camera.film.width == 768


HARMLESS = {
    "integrator": (
        '<integrator type="sms"><float name="a" value="1"/><sampler type="x"/></integrator>',
        "type 'sms': it",
    ),
    "its parameter": (
        '<integrator type="path"><boolean name="strict" value="true"/></integrator>',
        "parameter 'strict'",
    ),
    "inside aov": ('<integrator type="aov"><integrator type="sms"/></integrator>', "unknown type 'sms'"),
}
SETTINGS = {
    "sampler": ('<sampler type="sobol"><integer name="dimension" value="4"/></sampler>', "unknown type 'sobol'"),
    "its parameter": (
        '<sampler type="independent"><integer name="scramble" value="-1"/></sampler>',
        "'scramble' of sam",
    ),
    "film": ('<film type="hdrfilm"><float name="render_time" value="3"/></film>', "parameter 'render_time' of film"),
    "ldrfilm": ('<film type="ldrfilm"><float name="gamma" value="2"/></film>', "the image is linear"),
}


@pytest.mark.parametrize("content, message", HARMLESS.values(), ids=HARMLESS)
def test_integrators_of_others(load, content, message):
    with pytest.warns(UserWarning, match=message) as caught:
        load(SENSOR + content + CUBE % "")
    assert len(caught) == 1


@pytest.mark.parametrize("content, message", SETTINGS.values(), ids=SETTINGS)
def test_settings_of_others(load, content, message):
    with pytest.warns(UserWarning, match=message) as caught:
        load(f'<sensor type="perspective">{content}</sensor>' + CUBE % "")
    assert len(caught) == 1


CHANGES = {
    "a slip": (
        '<sensor type="perspective"><film type="hdrfilm"><integer name="widht" value="9"/></film></sensor>',
        "width",
    ),
    "hidden": (
        f'{SENSOR}<integrator type="sms"><boolean name="hide_emitters" value="true"/></integrator>',
        "hide_emit",
    ),
    "depth": (f'{SENSOR}<integrator type="depth"/>', "unknown type 'depth'"),
}


@pytest.mark.parametrize("content, message", CHANGES.values(), ids=CHANGES)
def test_what_changes_the_image_is_an_error(load, content, message):
    with pytest.raises(ValueError, match=message):
        load(content + CUBE % "")


REFUSED = {
    "curves": ('<shape type="bsplinecurve"/>', "curves are not supported; .*it is left out"),
    "grid": ('<shape type="sdfgrid"/>', "only meshes are supported; .*it is left out"),
    "null": (CUBE % '<bsdf type="null"/>', "rays pass through .* shapes that have it are left out"),
    "medium": (CUBE % '<medium type="homogeneous" name="interior"/>', "participating media .*space is empty"),
    "polarisation": (CUBE % '<bsdf type="pplastic"/>', "polarisation is not supported"),
}


@pytest.mark.parametrize("content, message", REFUSED.values(), ids=REFUSED)
def test_refusals_say_what_leaving_out_does(load, content, message):
    scene = SENSOR + '<shape type="sphere" id="there"/>\n' + content
    with pytest.raises(ValueError, match=f"line 3, .*{message}"):
        load(scene)
    with pytest.warns(UserWarning, match=message):
        left = load(scene, ignore_unsupported=True).shapes
    assert set(left) == ({"there", "c"} if "medium" in content or "pplastic" in content else {"there"})


def test_a_shape_without_area_can_be_left_out(load, tmp_path):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    content = SENSOR + CUBE % "" + '\n<shape type="obj"><string name="filename" value="flat.obj"/></shape>'
    with pytest.raises(ValueError, match=r"line 3, <shape>: .*none of the 1 faces has an area; with ignore_unsup"):
        load(content)
    with pytest.warns(UserWarning, match="the shape is left out"):
        assert list(load(content, ignore_unsupported=True).shapes) == ["c"]


def test_meshes_are_read_when_nothing_else_is_wrong(load, tmp_path, monkeypatch):
    def no_reading(path):
        raise AssertionError(f"{path} was read")

    monkeypatch.setattr("jaxdr.scene.formats.mitsuba.shapes.read_parts", no_reading)
    mesh = '<shape type="obj"><string name="filename" value="a.obj"/></shape>'
    with pytest.raises(ValueError, match="line 3, <shape>: unknown type 'hair'"):
        load(f'{SENSOR}{mesh}\n<shape type="hair"/>')
    with pytest.raises(AssertionError, match="was read"):
        load(SENSOR + mesh)


def test_what_several_shapes_refer_to_is_read_once(load_silently):
    scene = load_silently(
        f"""{SENSOR}<bsdf type="roughconductor" id="m"/><shape type="shapegroup" id="g"><shape type="cube"/></shape>
        <shape type="cube" id="a"><ref id="m"/></shape><shape type="sphere" id="b"><ref id="m"/></shape>
        <shape type="instance" id="i"><ref id="g"/></shape><shape type="instance" id="j"><ref id="g"/></shape>"""
    )
    assert scene.shapes["a"].bsdf is scene.shapes["b"].bsdf and {"i", "j"} < set(scene.shapes)


def test_files_are_found_in_the_working_directory(load_silently, tmp_path, monkeypatch):
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "more").mkdir(parents=True)
    for name in ("here.obj", "more/there.obj", "a.obj"):
        (elsewhere / name).write_text("v 0 0 7\nv 1 0 7\nv 0 1 7\nf 1 2 3\n")
    monkeypatch.chdir(elsewhere)
    shapes = [
        f'<shape type="obj" id="{n}"><string name="filename" value="{n}.obj"/></shape>' for n in ("here", "there", "a")
    ]
    scene = load_silently('<path value="more"/>' + SENSOR + "".join(shapes))
    assert [float(shape.mesh.vertices[0, 2]) for shape in scene.shapes.values()] == [
        0,
        7,
        7,
    ]  # a.obj of the scene first


HEAD, BODY = '<?xml version="1.0" encoding="{}"?>', '<scene version="3.0.0">\n<!-- é -->\n<shape id="%s"/></scene>'
TEXTS = {
    "dashes": b'<scene version="3.0.0"><!-- a -- b\n --->\n<shape/></scene>',
    "latin 1 that claims to be utf-8": (HEAD.format("utf-8") + BODY % "é").encode("latin-1"),
    "gbk": (HEAD.format("gbk") + BODY % "中").encode("gbk"),
    "utf-16": (HEAD.format("utf-16") + BODY % "中").encode("utf-16"),
    "byte order mark": (BODY % "中").encode("utf-8-sig"),
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_encodings_and_comments(tmp_path, text):
    path = tmp_path / "scene.xml"
    path.write_bytes(text)
    (shape,) = read_document(path, {}).children
    assert shape.line == 3 and shape.attributes.get("id") in (None, "é", "中")


def test_an_obj_that_is_not_utf_8(load_silently, tmp_path):
    (tmp_path / "a.obj").write_bytes("# größer\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode("latin-1"))
    path = tmp_path / "scene.xml"
    path.write_text(
        f'<scene version="3.0.0">{SENSOR}<shape type="obj"><string name="filename" value="a.obj"/></shape></scene>'
    )
    assert len(load_mitsuba(path).shapes["obj"].mesh.faces) == 1


def test_an_axis_of_another_length_is_as_in_mitsuba(mitsuba, scene_file):
    path = scene_file(SENSOR + CUBE % '<transform name="to_world"><rotate x="1" y="2" angle="50"/></transform>')
    with pytest.warns(UserWarning, match="axis has length 2.236: as in Mitsuba, .*scales and shears"):
        vertices = load_mitsuba(path).shapes["c"].mesh.vertices
    box = mitsuba.load_file(str(path)).shapes()[0].bbox()
    np.testing.assert_allclose([vertices.min(0), vertices.max(0)], [box.min, box.max], rtol=1e-6)


OPACITIES = ['<rgb name="opacity" value="0.5, 0.2, 0.9"/>', '<spectrum name="opacity" value="0.3"/>']


@pytest.mark.parametrize("opacity", OPACITIES)
def test_colours_as_numbers_are_as_in_mitsuba(mitsuba, scene_file, opacity):
    path = scene_file(SENSOR + CUBE % f'<bsdf type="mask">{opacity}<bsdf type="diffuse"/></bsdf>')
    bsdf = mitsuba.load_file(str(path)).shapes()[0].bsdf()
    passed = bsdf.eval_null_transmission(mitsuba.SurfaceInteraction3f())[0]
    np.testing.assert_allclose(load_mitsuba(path).shapes["c"].bsdf.opacity, 1 - passed, rtol=1e-5)


HILL = hill(3)
COLUMNS = {
    "floats": ({f"color_{k}": ("float", np.linspace(0.1 * k, 1, 9)) for k in range(3)}, {}, ["vertex_color"]),
    "bytes": ({name: ("uchar", np.arange(9)) for name in ("red", "green", "blue")}, {}, ["vertex_color"]),
    "one": ({"heat_0": ("float", np.arange(9.0))}, {}, ["vertex_heat"]),
    "faces": (
        {},
        {name: ("float", np.linspace(0.1, 0.9, 8)) for name in ("r", "g", "b", "w_0", "w_1", "w_2")},
        ["face_color", "face_w"],
    ),
    "letters": ({f"tint_{k}": ("float", np.arange(9.0)) for k in "rgb"}, {}, ["vertex_tint_color"]),
}


@pytest.mark.parametrize("vertex, face, names", COLUMNS.values(), ids=COLUMNS)
def test_attributes_as_in_mitsuba(mitsuba, tmp_path, vertex, face, names):
    from jaxdr.geometry.load import joined_arrays, read_parts
    from jaxdr.scene.formats.attributes import mesh_attributes

    path = tmp_path / "a.ply"
    path.write_text(ply(HILL["vertices"], HILL["faces"], vertex, face))
    parts = read_parts(path)
    _, rows = joined_arrays(parts, "flat")
    found = mesh_attributes(parts, rows)
    theirs = mitsuba.traverse(mitsuba.load_dict({"type": "ply", "filename": str(path)}))
    assert sorted(found) == sorted(names)
    for name in names:
        expected = np.reshape(theirs[name], (-1, found[name].shape[1]))
        order = rows if name.startswith("vertex") else np.arange(8)
        np.testing.assert_allclose(found[name][order], expected, rtol=1e-6)


def test_attributes_of_faces_without_area_and_of_vertices_that_become_one(tmp_path):
    from jaxdr.geometry.load import Triangles, joined_arrays
    from jaxdr.scene.formats.attributes import mesh_attributes
    from jaxdr.scene.formats.mitsuba.scene_shapes import _mesh
    from jaxdr.scene.formats.mitsuba.shapes import Plan, Source

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]])
    faces = np.array([[0, 1, 3], [0, 1, 2], [0, 3, 2]])
    stored = {
        "vertex": {"a_0": np.array([1.0, 2, 3, 2]), "b_0": np.arange(4.0)},
        "face": {"c_0": np.array([7.0, 8, 9])},
    }
    parts = [Triangles(corners, faces, stored=stored)]
    arrays, rows = joined_arrays(parts, "flat")
    attributes = mesh_attributes(parts, rows)
    assert attributes["vertex_b"] is None and attributes["vertex_a"].tolist() == [[1], [2], [3]]
    plan = Plan(
        Element("shape", {}, tmp_path, 1), lambda: Source(arrays, True, attributes), np.eye(4), False, None, None
    )
    with pytest.warns(UserWarning):
        mesh, kept = _mesh(plan)
    assert len(mesh.faces) == 2 and kept["face_c"].tolist() == [[8], [9]]


def test_a_projector_of_a_constant_is_as_in_mitsuba(mitsuba, scene_file):
    content = (
        '<emitter type="projector" id="p"><rgb name="irradiance" value="1, 2, 3"/><float name="fov" value="50"/>'
        "</emitter>"
        '<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="180"/>'
        '<translate z="3"/></transform></shape>'
    )
    path = scene_file(SENSOR + content)
    light = load_mitsuba(path).lights["p"]
    projector = mitsuba.load_file(str(path)).emitters()[0]
    points = np.array([[0.0, 0, 3], [1, 0.5, 3], [1.3, -1.3, 3], [1.5, 0, 3]])
    for point in points:
        si = mitsuba.SurfaceInteraction3f()
        si.p = point
        _, spectrum = projector.sample_direction(si, [0.5, 0.5])
        distance = np.linalg.norm(point)
        ours = np.asarray(light.intensity_in(np.asarray(point / distance, np.float32)[None]))[0] / distance**2
        np.testing.assert_allclose(ours, np.array(spectrum), rtol=1e-4)
