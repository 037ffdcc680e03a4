"""Scene files as trees: places of errors, variables, includes, search paths, aliases, references."""

import pytest

from jaxdr.scene.formats.mitsuba.document import Variables, read_document, read_xml
from jaxdr.scene.formats.mitsuba.element import SceneFileError


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
    "strange version": ('<scene version="3.0"/>', r"line 1, <scene>: version '3.0' is not one of Mitsuba \(such as"),
    "default without value": ('<default name="a"/>', r"line 2, <default>: attribute 'value' is missing"),
    "include of nothing": ('<include filename="no.xml"/>', r"line 2, <include>: there is no file .*no.xml"),
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


def test_files_are_looked_for_beside_the_file_that_names_them(read, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "shape.xml").write_text('<shape version="3.0.0" type="obj"/>')
    (tmp_path / "parts" / "all.xml").write_text('<scene version="3.0.0"><include filename="shape.xml"/></scene>')
    for name in ("parts/a.obj", "a.obj", "b.obj"):
        (tmp_path / name).touch()
    (shape,) = read('<include filename="parts/all.xml"/>').children
    assert shape.find_file("a.obj") == tmp_path / "parts" / "a.obj"
    assert shape.find_file("b.obj") == tmp_path / "b.obj"  # then beside the main file
    with pytest.raises(ValueError, match=r"there is no file .*parts/c\.obj or .*c\.obj"):
        shape.find_file("c.obj")


def test_path_adds_a_folder_to_search_first(read, tmp_path):
    (tmp_path / "meshes").mkdir()
    for name in ("meshes/a.obj", "a.obj"):
        (tmp_path / name).touch()
    (shape,) = read('<shape type="obj"/><path value="meshes"/>').children
    assert shape.find_file("a.obj") == tmp_path / "meshes" / "a.obj"
    with pytest.raises(ValueError, match="line 2, <path>: there is no folder 'nowhere'"):
        read('<path value="nowhere"/>')
    with pytest.raises(ValueError, match="line 2, <path>: only allowed directly inside <scene>"):
        read('<shape type="obj"><path value="meshes"/></shape>')


@pytest.fixture
def resolve(read, tmp_path):
    """The whole document with references resolved, and the messages about those that can't be."""

    def read_and_resolve(text):
        read(text)
        root = read_document(tmp_path / "scene.xml", {})
        return root, [message.split("scene.xml, ", 1)[1] for *_, message, _ in root.problems.found]

    return read_and_resolve


def test_references_stand_for_any_object(resolve):
    root, problems = resolve(
        """<shape type="instance" id="i"><ref id="group"/></shape>
        <shape type="shapegroup" id="group"><shape type="cube"><ref id="alias" name="front"/></shape></shape>
        <bsdf type="twosided" id="two"><ref id="grey"/></bsdf>
        <bsdf type="diffuse" id="grey" name="back"><ref id="wood" name="reflectance"/></bsdf>
        <texture type="bitmap" id="wood"/>
        <alias id="two" as="alias"/>"""
    )
    assert problems == [] and [child.tag for child in root.children] == ["shape", "shape", "bsdf", "bsdf", "texture"]
    (cube,) = root.children[0].children[0].children
    (two,) = cube.children
    assert two.attributes == {"type": "twosided", "id": "two", "name": "front"}  # the name belongs to the reference
    (grey,) = two.children
    assert grey.attributes == {"type": "diffuse", "id": "grey"} and grey.line == 5
    assert grey.children[0].attributes == {"type": "bitmap", "id": "wood", "name": "reflectance"}


def test_references_that_lead_nowhere_are_all_listed(resolve):
    text = """ <bsdf type="twosided" id="a"><ref id="b"/></bsdf>
        <bsdf type="twosided" id="b"><ref id="a"/></bsdf>
        <shape type="cube"><ref id="gray"/></shape>
        <bsdf type="diffuse" id="grey"/><shape id="grey" type="cube"/>
        <ref name="x"/>"""
    root, problems = resolve(text)
    assert sorted(problems) == [
        "line 3, <ref>: refers to 'a', which contains it",
        "line 4, <ref>: there is no object with id 'gray'; did you mean 'grey'?",
        "line 5, <shape>: id 'grey' is taken by <bsdf> in " + f"{root.file}, line 5",
        "line 6, <ref>: attribute 'id' is missing",
    ]
    assert root.children[2].children == []


def test_an_alias_comes_after_its_object(resolve):
    with pytest.raises(ValueError, match="line 2, <alias>: there is no object with id 'grey' before this alias"):
        resolve('<alias id="grey" as="gray"/><bsdf type="diffuse" id="grey"/>')
