"""Reading elements: typed values, transforms, plugins, and what is noted about what nobody reads."""

import numpy as np
import pytest

from jaxdr.scene.formats.mitsuba.element import Element, Severity
from jaxdr.scene.formats.mitsuba.xml import Properties, read_plugin


def value_of(read, text, tags=None):
    """The value of one named element inside a shape."""
    element = read(f'<shape type="sphere">{text}</shape>').children[0]
    tag = element.children[0].tag
    return Properties(element).value("p", tags or tag)


VALUES = {
    '<boolean name="p" value="true"/>': True,
    '<boolean name="p" value="FALSE"/>': False,
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
    '<float name="p" value="nan"/>': "<float>: 'nan': must be a finite number from -1e+18 to 1e+18, got nan",
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
    '<spectrum name="p" value="400:1, 700"/>': "<spectrum>: expected pairs of wavelength and value such as 400:0.3",
    '<spectrum name="p" value=""/>': "<spectrum>: a spectrum needs two or more wavelengths",
    '<spectrum name="p" filename="a.spd"/>': "<spectrum>: there is no file",
    '<spectrum name="p" filename="a.spd" value="1"/>': "<spectrum>: unknown attribute 'value'",
    '<float name="p" value="1"/><float name="p" value="2"/>': "<float>: a second parameter 'p' in one <shape>",
    '<transform name="p"><skew value="1"/></transform>': "<skew>: unknown transform; known: translate, scale, rotate",
    '<transform name="p"><scale value="1, 2"/></transform>': "<scale>: expected 1 or 3 numbers",
    '<transform name="p"><scale w="1"/></transform>': "<scale>: unknown attribute 'w'",
    '<transform name="p"><rotate x="1"/></transform>': "<rotate>: attribute 'angle' is missing",
    '<transform name="p"><rotate angle="3"/></transform>': "<rotate>: the rotation axis must not be zero",
    '<transform name="p"><matrix value="1 2 3"/></transform>': "<matrix>: expected 9 or 16 numbers",
    '<transform name="p"><lookat origin="0 0 0" up="0 0 1"/></transform>': "<lookat>: attribute 'target' is missing",
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
    # Without an up vector it is Mitsuba's first tangent, here x; so left is y × …: up × forward = x × z = -y.
    '<lookat origin="1,2,3" target="1,2,4"/>': [[0, 1, 0, 1], [-1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
}


@pytest.mark.parametrize("steps, expected", TRANSFORMS.items())
def test_transforms(read, steps, expected):
    np.testing.assert_allclose(value_of(read, f'<transform name="p">{steps}</transform>'), expected, atol=1e-15)


def messages(element):
    """What was noted, without the file; and whether it may be ignored."""
    noted = element.problems.found
    return [(message.split("scene.xml, ")[1], severity is not Severity.MISTAKE) for *_, message, severity in noted]


def test_what_nobody_takes_is_noted(read):
    shape = read(
        '<shape type="cube"><float name="a" value="1"/><float name="widht" value="1"/><emitter type="c"/></shape>'
    ).children[0]
    properties = Properties(shape)
    assert properties.value("a", "float") == 1 and properties.value("width", "float", 7) == 7
    properties.ignore("not there")
    properties.finish()
    assert messages(shape) == [
        (
            "line 2, <float>: unknown parameter 'widht' of shape 'cube'; did you mean 'width'?; "
            "with ignore_unsupported it has no effect",
            True,
        ),
        ("line 2, <emitter>: not supported inside shape 'cube'; with ignore_unsupported it is left out", True),
    ]


def test_what_is_taken_or_ignored_is_not_noted(read):
    shape = read('<shape type="cube"><float name="b" value="1"/><emitter type="c"/></shape>').children[0]
    properties = Properties(shape)
    properties.ignore("b", "not there")
    assert properties.at_most_one("emitter").attributes["type"] == "c"
    properties.finish()
    assert messages(shape) == []


def test_unknown_elements_seconds_and_textures_are_noted(read):
    shape = read(
        """<shape type="cube"><colour name="p"/>
        <bsdf type="a"/>
        <bsdf type="b"/>
        <texture type="bitmap" name="radius"/><spectrum type="blackbody" name="height"/></shape>"""
    ).children[0]
    properties = Properties(shape)
    assert properties.at_most_one("bsdf").type == "a"
    assert properties.value("radius", "float", 2) == 2 and properties.texture("height").type == "blackbody"
    properties.finish()
    assert [message.split(";")[0] for message, _ in messages(shape)] == [
        "line 2, <colour>: unknown element",
        "line 4, <bsdf>: a second one in one <shape>",
        "line 5, <texture>: a texture can't give 'radius' here",
    ]
    assert all(ignorable for _, ignorable in messages(shape))


def test_plugins_are_looked_up_and_checked_for_leftovers(read):
    scene = read(
        """<shape type="good"><float name="size" value="3"/></shape>
        <shape type="sloppy"><float name="size" value="3"/></shape>
        <shape type="bad"/>
        <shape type="unknown"/>
        <shape/>"""
    )

    def bad(element):
        raise ValueError("no radius")

    table = {"good": lambda e: Properties(e).value("size", "float"), "sloppy": lambda e: 1, "bad": bad}
    assert [read_plugin(child, table, "it is left out") for child in scene.children] == [3, 1, None, None, None]
    assert messages(scene) == [
        (
            "line 3, <float>: unknown parameter 'size' of shape 'sloppy'; known: none; "
            "with ignore_unsupported it has no effect",
            True,
        ),
        ("line 4, <shape>: no radius", False),
        (
            "line 5, <shape>: unknown type 'unknown'; known: good, sloppy, bad; with ignore_unsupported it is left out",
            True,
        ),
        ("line 6, <shape>: attribute 'type' is missing", False),
    ]


def test_objects_need_a_type(tmp_path):
    with pytest.raises(ValueError, match="<shape>: attribute 'type' is missing"):
        Properties(Element("shape", {}, tmp_path, 1))
    with pytest.raises(ValueError, match="<shape>: unknown attribute 'colour'"):
        Properties(Element("shape", {"type": "cube", "colour": "red"}, tmp_path, 1))
