"""Scene files that are damaged or hostile: one error with file, line and element, soon, and nothing read wrongly."""

import os
import time
import warnings

import pytest

from jaxdr.scene.formats.mitsuba import document, element, parse, scene_shapes
from jaxdr.scene.formats.mitsuba.bsdfs import MOST_BSDFS
from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.formats.mitsuba.settings import mitsuba_settings
from jaxdr.untrusted import DEEPEST

from ..conftest import SENSOR

CUBE = '<shape type="cube" id="a"/>'
RANGE = r"must be a finite number from -1e\+18 to 1e\+18, got "


def shape(inside, kind="cube"):
    return f'<shape type="{kind}">{inside}</shape>'


def moved(step):
    return shape(f'<transform name="to_world">{step}</transform>')


def film(inside):
    return SENSOR.replace("</sensor>", f'<film type="hdrfilm">{inside}</film></sensor>') + CUBE


def diffuse(attributes):
    return shape(f'<bsdf type="diffuse"><spectrum name="reflectance" {attributes}/></bsdf>')


def refused(load, content, message):
    """Loading raises an error with this message, soon, and of a length that can be read."""
    start = time.process_time()
    with pytest.raises(ValueError, match=rf"^\S*\.xml, line \d+, .*{message}") as caught:
        load(content)
    assert time.process_time() - start < 20
    assert len(str(caught.value)) < 5000


NUMBERS = {
    "camera far away": (
        SENSOR.replace("</", '<transform name="to_world"><translate x="1e300"/></transform></', 1),
        "'1e300': " + RANGE,
    ),
    "huge step": (moved('<translate x="1e30"/>'), "<translate>: '1e30': " + RANGE),
    "huge steps": (moved('<scale value="1e15"/>' * 3), "<scale>: with this step the transform has numbers beyond"),
    "huge shape": (
        shape(
            '<float name="radius" value="1e15"/><transform name="to_world"><scale value="1e9"/></transform>', "sphere"
        ),
        r"its vertices go beyond 1e\+18; repair to_world",
    ),
    "not a number": (moved('<rotate x="1" angle="nan"/>'), RANGE + "nan"),
    "infinite": (moved('<matrix value="1 0 0 0 inf 0 0 0 1"/>'), RANGE + "inf"),
    "too many digits": (shape(f'<float name="radius" value="{"9" * 400}"/>', "sphere"), "…: " + RANGE + "inf"),
    "digits of Python": (shape('<float name="radius" value="1_0"/>', "sphere"), "expected numbers, got '1_0'"),
    "digits of others": (shape('<float name="radius" value="٣"/>', "sphere"), "expected numbers"),
    "integer of 5,000 digits": (film(f'<integer name="width" value="{"9" * 5000}"/>'), "5000 digits is too large"),
    "integer beyond 2^53": (film(f'<integer name="width" value="{2**60}"/>'), "must be a whole number from -9007199"),
    "integer with a fraction": (film('<integer name="width" value="1e3"/>'), "expected an integer, got '1e3'"),
    "integer of Python": (film('<integer name="width" value="1_0"/>'), "expected an integer, got '1_0'"),
    "integer as a float": (shape(f'<integer name="radius" value="{"9" * 400}"/>', "sphere"), "400 digits is too large"),
    "film of 1e18 pixels": (
        film('<integer name="width" value="1000000000"/><integer name="height" value="1000000000"/>'),
        "width and height: expected 1 to 134217728 pixels, got 1000000000 x 1000000000",
    ),
    "film without pixels": (film('<integer name="width" value="0"/>'), "expected 1 to 134217728 pixels, got 0 x"),
    "wide filter": (
        film('<rfilter type="gaussian"><float name="stddev" value="1e6"/></rfilter>'),
        "stddev: must be a finite number from 0.001 to 1000, got 1000000.0",
    ),
    "narrow filter": (film('<rfilter type="tent"><float name="radius" value="1e-9"/></rfilter>'), "radius: must be a"),
    "spectrum": (diffuse('value="400:1, 500:1e300"'), "'500:1e300': " + RANGE),
    "spectrum of one number": (diffuse('value="1e300"'), "'1e300': " + RANGE),
    "index -1": (
        shape('<bsdf type="principled"><float name="eta" value="-1"/></bsdf>'),
        "<bsdf>: eta must be positive, got -1.0",
    ),
}


@pytest.mark.parametrize("content, message", NUMBERS.values(), ids=NUMBERS)
def test_numbers_are_finite_and_in_a_range(load, content, message):
    refused(load, content if "<sensor" in content else SENSOR + content, message)


@pytest.mark.parametrize("value", ["1e300", "nan", "1_0"])
@pytest.mark.parametrize("tag", ["srgb", "rgb", "spectrum"])
def test_colors_of_old_files_are_refused_even_if_what_is_unsupported_is_ignored(tmp_path, tag, value):
    path = tmp_path / "scene.xml"
    content = shape(f'<bsdf type="diffuse"><{tag} name="reflectance" value="{value}"/></bsdf>')
    path.write_text(f'<scene version="0.6.0">{SENSOR}{content}</scene>')
    with pytest.raises(ValueError, match=r"scene.xml, line 1, <\w+>: (.*must be a finite number|expected numbers)"):
        load_mitsuba(path, ignore_unsupported=True)


def test_products_that_overflow_are_named(load):
    scaled = '<texture type="scale" name="{}"><float name="scale" value="1e15"/>'
    nested = scaled.format("radiance") + scaled.format("x") * 3 + '<texture type="checkerboard"/>' + "</texture>" * 4
    message = r"<texture>: its values times 1e\+15 are not finite"
    refused(load, SENSOR + shape(f'<emitter type="area">{nested}</emitter>'), message)


@pytest.mark.parametrize(
    "content, place",
    [
        ("400 1\nnan 2\n", r"a.spd, line 2: 'nan:2': must be a finite number"),
        ("# nm\n400 1\n\n500 1e300\n", r"a.spd, line 4: '500:1e300': must be a finite number"),
        ("400 1\n500 x\n", r"a.spd, line 2: expected numbers, got '500:x'"),
        ("400 1\n500\n", r"a.spd, line 2: expected pairs"),
        ("", r"a.spd: a spectrum needs two or more"),
        (b"400 1\n500 \xff\n", r"a.spd: can't be read as text in UTF-8"),
    ],
)
def test_spectrum_files(load, tmp_path, content, place):
    (tmp_path / "a.spd").write_bytes(content if isinstance(content, bytes) else content.encode())
    refused(load, SENSOR + diffuse('filename="a.spd"'), place)


@pytest.mark.parametrize("value", ["1e3", str(2**31), "-7", "9" * 5000, "1_0", ""])
def test_settings_are_whole_numbers_of_32_bits(scene_file, value):
    for content in (
        f'<integrator type="path"><integer name="max_depth" value="{value}"/></integrator>' + SENSOR,
        SENSOR.replace("</", f'<sampler type="x"><integer name="sample_count" value="{value}"/></sampler></', 1),
    ):
        refused(lambda text: mitsuba_settings(scene_file(text)), content + CUBE, "")


def test_variables_that_double_each_other(load):
    doubled = "".join(f'<default name="a{i + 1}" value="$a{i}$a{i}"/>' for i in range(60))
    refused(load, f'<default name="a0" value="xxxxxxxxxx"/>{doubled}' + SENSOR + CUBE, "<default>: variables add more")


def test_a_variable_with_a_long_name(load):
    refused(load, SENSOR + f'<shape type="${"a" * 300_000}"/>', r"variable \$a*… has no value")


def test_comments_without_an_end(load):
    refused(load, "<!-- a -->" + "<!--" * 60_000 + SENSOR + CUBE, "malformed XML")


def test_comments_with_dashes_are_still_read(load):
    assert list(load("<!-- a -- b -->\n" * 3 + SENSOR + "<!---->" + CUBE + "<!-- -- -->").shapes) == ["a"]


def test_nesting_is_bounded(load):
    masks = DEEPEST - 3  # in <scene> and <shape>, and with a BSDF inside
    deep = '<bsdf type="mask">' * masks + '<bsdf type="diffuse"/>' + "</bsdf>" * masks
    assert list(load(SENSOR + shape(deep)).shapes) == ["cube"]
    for n in (DEEPEST, 400, 50_000):
        refused(load, SENSOR + '<bsdf type="mask">' * n + "</bsdf>" * n, "nested more than 64 levels deep")
        refused(load, SENSOR + "<x>" * n + "</x>" * n, "nested more than 64 levels deep")


def chain(n, each):
    """BSDFs that refer to the next one."""
    return [f'<bsdf type="{each}" id="b{i}"/>'.replace("/>", f'><ref id="b{i + 1}"/></bsdf>') for i in range(n)]


@pytest.mark.parametrize("n", [70, 300])
@pytest.mark.parametrize("order", [1, -1])
def test_chains_of_references_are_bounded(load, n, order):
    bsdfs = [*chain(n, "mask"), f'<bsdf type="diffuse" id="b{n}"/>'][::order]
    with pytest.raises(ValueError, match=r"scene.xml.* (levels deep|elements, with those that it refers to)"):
        load(SENSOR + "".join(bsdfs) + shape('<ref id="b0"/>'))


@pytest.mark.parametrize("n", [8, 16, 30, 60])
def test_references_that_double_each_other(load, n):
    both = [
        f'<bsdf type="blendbsdf" id="b{i}"><float name="weight" value="0.5"/>' + f'<ref id="b{i + 1}"/>' * 2 + "</bsdf>"
        for i in range(n)
    ]
    content = SENSOR + "".join(both) + f'<bsdf type="diffuse" id="b{n}"/>' + shape('<ref id="b0"/>')
    start = time.process_time()
    with pytest.raises(ValueError, match=rf"scene.xml.*(more than {MOST_BSDFS} BSDFs|more than {10**6} elements)"):
        load("\n" + content if n > 8 else content)
    assert time.process_time() - start < 20


def test_textures_that_double_each_other_in_a_light(load):
    both = [f'<texture type="scale" id="t{i}">' + f'<ref id="t{i + 1}"/>' * 2 + "</texture>" for i in range(30)]
    content = SENSOR + "".join(both) + '<texture type="mesh_attribute" id="t30"/>' + CUBE
    refused(load, content, "more than 1000000 elements, with those that it refers to")


def test_many_bsdfs_in_one_mixture(load):
    parts = '<string name="weights" value="0.1"/>' + '<bsdf type="diffuse"/>' * (MOST_BSDFS + 1)
    refused(load, SENSOR + shape(f'<bsdf type="mixturebsdf">{parts}</bsdf>'), f"more than {MOST_BSDFS} BSDFs inside")


def test_instances_that_multiply(load, monkeypatch):
    monkeypatch.setattr(scene_shapes, "MOST_SHAPES", 12)
    group = f'<shape type="shapegroup" id="g">{shape("") * 4}</shape>'
    instance = '<shape type="instance"><ref id="g"/></shape>'
    assert len(load(SENSOR + group + instance * 3).shapes) == 12
    refused(load, SENSOR + group + instance * 4, "more than 12 shapes; join them into fewer mesh files")


def write_includes(folder, levels, times):
    for i in range(levels):
        include = f'<include filename="i{i + 1}.xml"/>' * times
        (folder / f"i{i}.xml").write_text(f'<scene version="3.0.0">{include}</scene>')
    (folder / f"i{levels}.xml").write_text('<scene version="3.0.0"><bsdf type="diffuse"/></scene>')


def test_includes_that_double_each_other(load, tmp_path, monkeypatch):
    monkeypatch.setattr(parse, "MOST_FILES", 50)
    write_includes(tmp_path, 8, 10)
    refused(load, SENSOR + '<include filename="i0.xml"/>' + CUBE, "includes more than 50 files")


def test_a_chain_of_includes(load, tmp_path):
    write_includes(tmp_path, 200, 1)
    refused(load, SENSOR + '<include filename="i0.xml"/>' + CUBE, "nested more than 64 levels deep")


def test_elements_of_all_files_are_counted(load, tmp_path, monkeypatch):
    monkeypatch.setattr(parse, "MOST_ELEMENTS", 100)
    (tmp_path / "part.xml").write_text(f'<scene version="3.0.0">{"<bsdf/>" * 30}</scene>')
    refused(load, SENSOR + '<include filename="part.xml"/>' * 4, "more than 100 elements, with those of its included")


def test_elements_that_references_stand_for_are_counted(load, monkeypatch):
    monkeypatch.setattr(document, "MOST_REFERRED", 50)
    group = f'<shape type="shapegroup" id="g">{shape("") * 20}</shape>'
    refused(load, SENSOR + group + '<shape type="instance"><ref id="g"/></shape>' * 3, "more than 50 elements, with")


def test_folders_are_bounded(load, tmp_path):
    refused(load, f'<path value="../{tmp_path.name}"/>' * 100 + SENSOR + CUBE, "looked for in more than 64 folders")


ENTITIES = {
    "billion laughs": '[<!ENTITY a "ha"><!ENTITY b "&a;&a;">]',
    "other file": '[<!ENTITY a SYSTEM "file:///etc/hostname">]',
    "parameter entity": '[<!ENTITY % a SYSTEM "file:///etc/hostname"> %a;]',
    "address": 'SYSTEM "http://localhost/scene.dtd"',
    "defaults of attributes": "[<!ATTLIST shape id CDATA 'b'>]",
}


@pytest.mark.parametrize("declared", ENTITIES.values(), ids=ENTITIES)
def test_entities_are_refused(tmp_path, declared):
    path = tmp_path / "scene.xml"
    path.write_text(f'<!DOCTYPE scene {declared}>\n<scene version="3.0.0">{SENSOR}{CUBE}&a;</scene>')
    refused(load_mitsuba, path, "<!DOCTYPE> with entities or an address is not supported; remove it")


def test_a_document_type_alone_is_read(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(f'<!DOCTYPE scene>\n<scene version="3.0.0">{SENSOR}{CUBE}</scene>')
    assert list(load_mitsuba(path).shapes) == ["a"]


NO_ENCODINGS = ["punycode", "undefined", "nothing", "utf-7", "hex", "zlib", "rot13", "cp037", "utf-16", "x" * 1000]


@pytest.mark.parametrize("encoding", [*NO_ENCODINGS, "unicode_escape", "raw_unicode_escape"])
def test_encodings_that_are_none_of_text(tmp_path, encoding):
    path = tmp_path / "scene.xml"
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?>\n<scene version="3.0.0">{SENSOR}{CUBE}</scene>')
    refused(load_mitsuba, path, "malformed XML: unknown encoding .*; save the file in UTF-8")


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "iso-8859-15", "windows-1252", "shift_jis", "utf-8-sig"])
def test_encodings_of_text(tmp_path, encoding):
    path = tmp_path / "scene.xml"
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n<scene version="3.0.0">{SENSOR}{CUBE}</scene>'
    path.write_bytes(text.encode(encoding))
    assert list(load_mitsuba(path).shapes) == ["a"]


@pytest.mark.parametrize("declared", ["utf-16", "punycode"])
def test_utf_16(tmp_path, declared):
    """The first bytes say what it is, whatever the declaration says."""
    path = tmp_path / "scene.xml"
    text = f'<?xml version="1.0" encoding="{declared}"?>\n<!-- -- --><scene version="3.0.0">{SENSOR}{CUBE}</scene>'
    path.write_bytes(text.encode("utf-16"))
    assert list(load_mitsuba(path).shapes) == ["a"]
    path.write_bytes(text.encode("utf-16")[:-1])
    refused(load_mitsuba, path, "not in UTF-16 as its first bytes say")


@pytest.fixture
def no_files(tmp_path):
    """Names that are no regular files."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "device").symlink_to("/dev/zero")
    return ["pipe", "folder", "device", "/dev/zero", "none", "", ".", "a" * 300, "a" * 10_000]


def test_only_regular_files_are_read(load, no_files):
    for name in no_files:
        refused(load, SENSOR + diffuse(f'filename="{name}"'), "there is no file")
        refused(load, SENSOR + CUBE + f'<include filename="{name}"/>', "there is no file")
        picture = f'<string name="filename" value="{name}"/>'
        refused(load, SENSOR + CUBE + f'<emitter type="envmap">{picture}</emitter>', "there is no file")
        for kind in ("obj", "ply", "serialized"):
            refused(load, SENSOR + shape(picture, kind), "there is no file")


def test_the_scene_itself_is_a_regular_file(tmp_path, no_files):
    for name in no_files[:-1]:
        for read in (load_mitsuba, mitsuba_settings):
            with pytest.raises(ValueError, match=r"can't read this scene file: "):
                read(tmp_path / name)


def test_long_lists_of_problems_are_cut(load, monkeypatch):
    monkeypatch.setattr(element, "MOST_PROBLEMS", 5)
    content = SENSOR + CUBE + "".join(f"\n<y{i}/>" for i in range(20))
    with pytest.raises(ValueError, match=r"scene.xml has 20 problems:") as caught:
        load(content)
    lines = str(caught.value).split("\n  ")
    assert len(lines) == 7 and lines[-1] == "and 15 more"
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        load(content, ignore_unsupported=True)
    assert len(told) == 6 and "and 15 more warnings like these" in str(told[-1].message)


@pytest.mark.filterwarnings("ignore:.*unknown element")
def test_mistakes_are_told_after_many_warnings(load, monkeypatch):
    monkeypatch.setattr(element, "MOST_PROBLEMS", 5)
    content = SENSOR + "".join(f"<y{i}/>" for i in range(20)) + shape('<float name="radius" value="x"/>', "sphere")
    with pytest.raises(ValueError, match=r"<float>: expected numbers, got 'x'"):
        load(content, ignore_unsupported=True)


def test_guesses_of_names_end_after_many_problems(load, monkeypatch):
    monkeypatch.setattr(document, "SUGGESTIONS", 5)
    with pytest.raises(ValueError, match="has 20 problems") as caught:
        load(SENSOR + '<bsdf type="diffuse" id="d10"/>' + shape("".join(f'<ref id="d{i + 100}"/>' for i in range(20))))
    assert str(caught.value).count("did you mean 'd10'?") == 6
