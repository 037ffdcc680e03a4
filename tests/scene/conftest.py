"""Scene files with mesh files beside them, loaded or as elements."""

import pytest

from jaxdr.scene.formats.mitsuba.document import Variables, read_xml
from jaxdr.scene.formats.mitsuba.load import load_mitsuba

SENSOR = '<sensor type="perspective"><float name="fov" value="40"/></sensor>'
OBJ = """
v -1 -1 0
v 1 -1 0
v 1 1 0.5
v -1 1 0
f 1 2 3
f 1 3 4
"""
PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-1 -1 0
1 -1 0
1 1 0.5
-1 1 0
3 0 1 2
3 0 2 3
"""
# Two faces that meet at an edge where the UVs jump, folded a little; materials that are to change nothing.
SEAM_OBJ = """
v 0 -1 0.3
v 0 1 0.3
v 1 0 0
v -1 0 0
vt 0 0
vt 0 1
vt 1 0
vt 0.5 0
vt 0.5 1
usemtl one
f 1/1 3/3 2/2
usemtl two
f 1/4 2/5 4/3
"""
NORMALS_OBJ = OBJ.replace("f 1 2 3\nf 1 3 4", "vn 0 -0.25 1\nvn -0.25 0 1\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2")


@pytest.fixture
def scene_file(tmp_path):
    """Write a scene with this content, and the mesh files beside it; its path."""
    for name, text in {"a.obj": OBJ, "a.ply": PLY, "normals.obj": NORMALS_OBJ, "seam.obj": SEAM_OBJ}.items():
        (tmp_path / name).write_text(text)

    def write(content):
        path = tmp_path / "scene.xml"
        path.write_text(f'<scene version="3.0.0">\n{content}\n</scene>')
        return path

    return write


@pytest.fixture
def read(tmp_path):
    """Write the text (the content of <scene>, or a whole document) to scene.xml and read its elements."""

    def write_and_read(text, **variables):
        whole = text if text.startswith(("<?xml", "<scene", "<bsdf")) else f'<scene version="3.0.0">\n{text}\n</scene>'
        (tmp_path / "scene.xml").write_text(whole)
        return read_xml(tmp_path / "scene.xml", Variables(variables))

    return write_and_read


@pytest.fixture
def load(scene_file):
    """Load a scene with this content."""
    return lambda content, **variables: load_mitsuba(scene_file(content), **variables)


@pytest.fixture
def load_shape(load):
    """The one shape of a scene that has this content besides a sensor."""

    def load_one(content):
        (shape,) = load(SENSOR + content).shapes.values()
        return shape

    return load_one
