"""Syntax of scene files: places of errors, variables, includes, values, transforms."""

import numpy as np
import pytest

from jaxdr.scene.mitsuba_xml import Element, Properties, SceneFileError, Variables, read_xml


@pytest.fixture
def read(tmp_path):
    """Write the text (the content of <scene>, or a whole document) to scene.xml and read it."""

    def write_and_read(text, name="scene.xml", **variables):
        whole = text if text.startswith(("<?xml", "<scene", "<bsdf")) else f'<scene version="3.0.0">\n{text}\n</scene>'
        (tmp_path / name).write_text(whole)
        return read_xml(tmp_path / name, Variables(variables))

    return write_and_read


def value_of(read, text, tags=None):
    """The value of one named element inside a shape."""
    element = read(f'<shape type="sphere">{text}</shape>').children[0]
    tag = element.children[0].tag
    return Properties(element).value("p", tags or tag)


def test_elements_know_their_file_and_line(read, tmp_path):
    root = read(
        '<?xml version="1.0"?>\n<!-- comment -->\n<scene version="3.0.0">\n\n <shape type="cube"\n id="a"/>\n</scene>'
    )
    (shape,) = root.children
    assert (shape.tag, shape.attributes, shape.line) == ("shape", {"type": "cube", "id": "a"}, 5)
    assert str(shape.error("wrong")) == f"{tmp_path / 'scene.xml'}, line 5, <shape>: wrong"


def test_variables_override_defaults_and_the_longest_name_is_taken(read):
    text = '<default name="a" value="1"/>\n<shape type="$a$ab" id="x$a_b"/>'
    assert read(text, ab=2).children[0].attributes == {"type": "12", "id": "x1_b"}
    assert read(text, ab="2", a=True).children[0].attributes == {"type": "true2", "id": "xtrue_b"}


def test_a_default_counts_from_where_it_stands(read):
    with pytest.raises(SceneFileError, match=r"scene.xml, line 2, <shape>: variable \$a has no value"):
        read('<shape type="$a"/>\n<default name="a" value="1"/>')


def test_includes(read, tmp_path):
    (tmp_path / "parts").mkdir()
    part = '<default name="kind" value="cube"/>\n<shape type="$kind"/><shape type="sphere"/>'
    (tmp_path / "parts" / "shapes.xml").write_text(f'<scene version="3.0.0">{part}</scene>')
    (tmp_path / "parts" / "grey.xml").write_text('<bsdf version="3.0.0" type="diffuse"/>')
    text = (
        '<include filename="parts/$file.xml"/>'
        '<shape type="$kind"><include filename="parts/grey.xml"/></shape>'  # the included default holds from here on
    )
    root = read(text, file="shapes")
    assert [shape.attributes["type"] for shape in root.children] == ["cube", "sphere", "cube"]
    assert root.children[0].file == tmp_path / "parts" / "shapes.xml" and root.children[0].line == 2
    assert [child.tag for child in root.children[2].children] == ["bsdf"]
    assert read(text, file="shapes", kind="sphere").children[0].attributes["type"] == "sphere"


ERRORS = {
    "malformed": ('<shape type="cube">\n</scene>', r"line 3, <shape>: malformed XML: mismatched tag"),
    "cut off": ('<scene version="3.0.0">\n<shape type="cube">', r"line 2, <shape>: malformed XML: no element found"),
    "not XML": ("<scene version='3.0.0'", r"line 1, <xml>: malformed XML"),
    "text": ('<shape type="cube">\nhello</shape>', r"line 3, <shape>: unexpected text 'hello'"),
    "undefined variable": ('<shape type="$kind"/>', r"line 2, <shape>: variable \$kind has no value; give it"),
    "lonely dollar": ('<shape type="a$"/>', r"line 2, <shape>: variable \$ has no value"),
    "no version": ("<scene>\n</scene>", r"line 1, <scene>: attribute 'version' is missing"),
    "old version": ('<scene version="0.6.0"/>', r"line 1, <scene>: version '0.6.0' is not one of Mitsuba 2 or 3"),
    "default without value": ('<default name="a"/>', r"line 2, <default>: attribute 'value' is missing"),
    "include of nothing": ('<include filename="no.xml"/>', r"line 2, <include>: included file .*no.xml does not exist"),
    "include of itself": ('<include filename="scene.xml"/>', r"line 2, <include>: .*scene.xml includes itself"),
    "unknown encoding": ('<?xml version="1.0" encoding="no"?><scene/>', r"line 1, <xml>: malformed XML: unknown enc"),
    "outermost include": (
        '<?xml version="1.0"?><include filename="no.xml"/>',
        r"line 1, <include>: .*'version' is mis",
    ),
    "child of a default": ('<default name="a" value="1"><shape/></default>', r"line 2, <shape>: unexpected inside"),
}


@pytest.mark.parametrize("text, message", ERRORS.values(), ids=ERRORS)
def test_errors_name_file_line_and_tag(read, text, message):
    with pytest.raises(ValueError, match=r"scene.xml, " + message):
        read(text)


def test_errors_in_an_included_file_name_that_file(read, tmp_path):
    (tmp_path / "part.xml").write_text('<scene version="3.0.0">\n\n<shape type="$a"/></scene>')
    with pytest.raises(ValueError, match=r"part.xml, line 3, <shape>: variable"):
        read('<include filename="part.xml"/>')


def test_missing_file(tmp_path):
    with pytest.raises(ValueError, match=r"no\.xml: can't read this scene file: No such file"):
        read_xml(tmp_path / "no.xml", Variables({}))


VALUES = {
    '<boolean name="p" value="true"/>': True,
    '<integer name="p" value=" -3 "/>': -3,
    '<float name="p" value="1e-2"/>': 0.01,
    '<string name="p" value="a b"/>': "a b",
    '<point name="p" value="1, 2 ,3"/>': [1, 2, 3],
    '<point name="p" x="1" y="2" z="3"/>': [1, 2, 3],
    '<vector name="p" value="1 2 3"/>': [1, 2, 3],
    '<rgb name="p" value="0.1, 0.2, 0.3"/>': [0.1, 0.2, 0.3],
    '<rgb name="p" value="0.1"/>': [0.1, 0.1, 0.1],
    '<spectrum name="p" value="0.1"/>': [0.1, 0.1, 0.1],
}


@pytest.mark.parametrize("text, expected", VALUES.items())
def test_values(read, text, expected):
    assert np.array_equal(value_of(read, text), expected)


BAD_VALUES = {
    '<boolean name="p" value="yes"/>': "<boolean>: expected true or false, got 'yes'",
    '<integer name="p" value="1.5"/>': "<integer>: expected an integer, got '1.5'",
    '<float name="p" value="wide"/>': "<float>: expected numbers, got 'wide'",
    '<float name="p" value=""/>': "<float>: expected numbers, got ''",
    '<float name="p" value="nan"/>': "<float>: 'nan' is not finite",
    '<float name="p" value="1, 2"/>': "<float>: expected 1 numbers, got '1, 2'",
    '<float name="p" value="1" x="2"/>': "<float>: unknown attribute 'x'; known: name, value",
    '<float name="p"/>': "<float>: attribute 'value' is missing",
    '<float name="p" value="1"><float name="q" value="1"/></float>': "<float>: unexpected inside <float>",
    '<float value="1"/>': "<float>: attribute 'name' is missing",
    '<point name="p" x="1" y="2"/>': "<point>: attribute 'z' is missing",
    '<point name="p" x="1" value="1, 2, 3"/>': "<point>: unknown attribute 'x'",
    '<point name="p" value="1, 2"/>': "<point>: expected 1 or 3 numbers, got '1, 2'",
    '<rgb name="p" value="#7f7f7f"/>': "<rgb>: hexadecimal colours are not part of Mitsuba 3",
    '<rgb name="p" value="1, 2"/>': "<rgb>: expected 1 or 3 numbers",
    '<spectrum name="p" value="400:1, 700:1"/>': "<spectrum>: expected numbers, got '400:1, 700:1'",
    '<spectrum name="p" filename="a.spd"/>': "<spectrum>: unknown attribute 'filename'",
    '<float name="p" value="1"/><float name="p" value="2"/>': "<float>: a second parameter 'p' in one <shape>",
    '<medium name="p"/>': "<medium>: unknown element",
    '<transform name="p"><skew value="1"/></transform>': "<skew>: unknown transform; known: translate, scale, rotate",
    '<transform name="p"><scale value="1, 2"/></transform>': "<scale>: expected 1 or 3 numbers",
    '<transform name="p"><scale w="1"/></transform>': "<scale>: unknown attribute 'w'",
    '<transform name="p"><rotate x="1"/></transform>': "<rotate>: attribute 'angle' is missing",
    '<transform name="p"><rotate angle="3"/></transform>': "<rotate>: the rotation axis must have length 1",
    '<transform name="p"><rotate x="1" y="1" angle="3"/></transform>': "<rotate>: the rotation axis must have length 1",
    '<transform name="p"><matrix value="1 2 3"/></transform>': "<matrix>: expected 9 or 16 numbers",
    '<transform name="p"><lookat origin="0 0 0" target="0 0 1"/></transform>': "<lookat>: attribute 'up' is missing",
    '<transform name="p"><lookat origin="0 0 0" target="0 0 1" up="0 0 1"/></transform>': "<lookat>: look_at: up",
    f'<transform name="p"><matrix value="{"1 " * 16}"/></transform>': "<matrix>: the last row of a matrix must be",
}


@pytest.mark.parametrize("text, message", BAD_VALUES.items())
def test_bad_values_name_their_place(read, text, message):
    with pytest.raises(ValueError) as caught:
        value_of(read, text)
    assert str(caught.value).split("scene.xml, line 2, ")[1].startswith(message)


def test_a_value_of_another_kind(read):
    with pytest.raises(ValueError, match="<string>: parameter 'p' must be given by <float> or <integer>"):
        value_of(read, '<string name="p" value="1"/>', "float integer")


TRANSFORMS = {
    "": np.eye(4),
    '<translate x="1" z="3"/>': [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]],
    '<translate value="1, 2, 3"/>': [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
    '<scale value="2"/>': np.diag([2, 2, 2, 1]),
    '<scale value="2 3 4"/>': np.diag([2, 3, 4, 1]),
    '<scale y="3"/>': np.diag([1, 3, 1, 1]),
    '<rotate z="1" angle="90"/>': [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    '<rotate value="0, 0, 1" angle="90"/>': [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    '<matrix value="0 1 2 3 4 5 6 7 8 9 1 2 0 0 0 1"/>': [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 1, 2], [0, 0, 0, 1]],
    '<matrix value="1 2 3 4 5 6 7 8 9"/>': [[1, 2, 3, 0], [4, 5, 6, 0], [7, 8, 9, 0], [0, 0, 0, 1]],
    '<scale value="2"/><translate x="1"/>': [[2, 0, 0, 1], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]],
    '<translate x="1"/><scale value="2"/>': [[2, 0, 0, 2], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]],
    # Looking along +z from (1, 2, 3): left is +x, up is +y.
    '<lookat origin="1,2,3" target="1,2,4" up="0,1,0"/>': [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
}


@pytest.mark.parametrize("steps, expected", TRANSFORMS.items())
def test_transforms(read, steps, expected):
    np.testing.assert_allclose(value_of(read, f'<transform name="p">{steps}</transform>'), expected, atol=1e-15)


def test_what_nobody_takes_is_an_error(read):
    shape = read('<shape type="cube"><float name="a" value="1"/><float name="b" value="1"/><emitter type="c"/></shape>')
    properties = Properties(shape.children[0])
    assert properties.value("a", "float") == 1 and properties.value("c", "float", 7) == 7
    with pytest.raises(ValueError, match=r"<float>: unknown parameter 'b' of shape 'cube'"):
        properties.finish()
    properties.ignore("b", "not there")
    with pytest.raises(ValueError, match=r"<emitter>: not supported inside shape 'cube'"):
        properties.finish()
    assert properties.at_most_one("emitter").attributes["type"] == "c"
    properties.finish()


def test_objects_need_a_type(tmp_path):
    with pytest.raises(ValueError, match="<shape>: attribute 'type' is missing"):
        Properties(Element("shape", {}, tmp_path, 1))
    with pytest.raises(ValueError, match="<shape>: unknown attribute 'colour'"):
        Properties(Element("shape", {"type": "cube", "colour": "red"}, tmp_path, 1))
