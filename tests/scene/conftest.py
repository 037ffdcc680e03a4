"""A scene file with mesh files beside it."""

import pytest

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
NORMALS_OBJ = OBJ.replace("f 1 2 3\nf 1 3 4", "vn 0 -0.25 1\nvn -0.25 0 1\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2")


@pytest.fixture
def scene_file(tmp_path):
    """Write a scene with this content, and the mesh files beside it; its path."""
    for name, text in {"a.obj": OBJ, "a.ply": PLY, "normals.obj": NORMALS_OBJ}.items():
        (tmp_path / name).write_text(text)

    def write(content):
        path = tmp_path / "scene.xml"
        path.write_text(f'<scene version="3.0.0">\n{content}\n</scene>')
        return path

    return write
