"""The mesh, image and environment files of the scenes. All of them are procedural."""

import numpy as np
from PIL import Image

from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.shapes import displaced_sphere, sphere
from jaxdr.images import write_image


def write_files(folder):
    """Every file of every scene."""
    write_obj(folder / "bumpy.obj", displaced_sphere(5, amplitude=0.2, frequency=4.0), normals=True)
    write_obj(folder / "stone.obj", displaced_sphere(5, amplitude=0.3, frequency=3.0), normals=False)
    write_obj(folder / "coarse.obj", displaced_sphere(2, amplitude=0.3, frequency=3.0), normals=False)
    write_ply(folder / "ball.ply", sphere(4).smooth())
    write_ply(folder / "coloured.ply", sphere(2), colors=True)
    random = np.random.default_rng(0)
    Image.fromarray(random.integers(0, 256, (6, 8, 3), np.uint8)).save(folder / "colours.png")
    Image.fromarray(random.integers(40, 256, (8, 8), np.uint8)).save(folder / "grey.png")
    holes = np.kron(random.integers(0, 2, (5, 5)), np.full((2, 2), 255)).astype(np.uint8)
    Image.fromarray(holes).save(folder / "holes.png")
    y, x = np.mgrid[0:16, 0:16] / 16 * 2 * np.pi
    normal = np.stack([0.5 * np.sin(2 * x), 0.4 * np.cos(3 * y), np.ones_like(x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    Image.fromarray(np.round(255 * (normal + 1) / 2).astype(np.uint8)).save(folder / "normal.png")
    write_image(folder / "sky.pfm", sky(12, 24))


def sky(height, width):
    """Radiance of all directions: blue above, brown below, a soft sun."""
    elevation = (np.arange(height) + 0.5)[:, None] / height * np.pi
    around = (np.arange(width) + 0.5)[None] / width * 2 * np.pi
    above = np.clip(0.5 + 2 * np.cos(elevation), 0, 1)[..., None]
    image = above * np.array([0.3, 0.5, 0.9]) + (1 - above) * np.array([0.25, 0.18, 0.1])
    sun = np.exp(-((elevation - 0.9) ** 2 + (around - 4.0) ** 2) / 0.15)[..., None]
    return (image + sun * np.array([9.0, 7.0, 4.0])).astype(np.float32)


def write_obj(path, mesh, normals):
    """An OBJ file, with interpolated normals if it is to look smooth."""
    lines = [f"v {x} {y} {z}" for x, y, z in np.asarray(mesh.vertices)]
    if normals:
        lines += [f"vn {x} {y} {z}" for x, y, z in np.asarray(mesh.smooth().vertex_normals())]
    corner = "{0}//{0}" if normals else "{0}"
    lines += ["f " + " ".join(corner.format(i + 1) for i in face) for face in np.asarray(mesh.faces)]
    path.write_text("\n".join(lines) + "\n")


def write_ply(path, mesh: Mesh, colors=False):
    """A PLY file, every corner a vertex of its own if there are UVs or normals; `colors` after the positions."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    columns, names = [vertices], ["x", "y", "z"]
    if mesh.uvs is not None or mesh.normal_faces is not None:
        columns, faces = [vertices[faces].reshape(-1, 3)], np.arange(faces.size).reshape(-1, 3)
    if mesh.normal_faces is not None:
        columns.append(np.asarray(mesh.vertex_normals())[np.asarray(mesh.normal_faces)].reshape(-1, 3))
        names += ["nx", "ny", "nz"]
    if mesh.uvs is not None:
        uvs = np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)].reshape(-1, 2)
        columns.append(uvs * (1, -1) + (0, 1))  # Mitsuba takes those of a PLY upside down
        names += ["u", "v"]
    if colors:
        columns.append(0.5 + 0.45 * np.sin(3 * vertices + [0, 2, 4]))
        names += ["r", "g", "b"]
    table = np.concatenate(columns, 1).astype(np.float32)
    header = ["ply", "format ascii 1.0", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, row)) for row in table]
    rows += ["3 {} {} {}".format(*face) for face in faces]
    path.write_text("\n".join(header + rows) + "\n")
