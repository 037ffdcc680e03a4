"""Procedural shapes: closedness, Euler characteristic, orientation, and areas and volumes against closed forms."""

import numpy as np
import pytest

from jaxdr.geometry.edges import BOUNDARY, dihedral
from jaxdr.geometry.shapes import (
    box,
    displaced_sphere,
    duck,
    pawn,
    plane,
    rectangle,
    revolved,
    sphere,
    star,
    torus,
    transformed,
    trefoil_tube,
)


def corners(mesh):
    return np.moveaxis(np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)], 1, 0)


def face_normals(mesh):
    """Normals with the length of twice the area."""
    a, b, c = corners(mesh)
    return np.cross(b - a, c - a)


def area(mesh):
    return np.linalg.norm(face_normals(mesh), axis=1).sum() / 2


def volume(mesh):
    """Signed: positive where the normals point outwards."""
    a, b, c = corners(mesh)
    return np.sum(a * np.cross(b, c)) / 6


def euler_characteristic(mesh):
    return len(mesh.vertices) - len(mesh.edges.kind) + len(mesh.faces)


CLOSED = {
    "sphere": (sphere(2), 0),
    "displaced sphere": (displaced_sphere(3), 0),
    "duck": (duck(3), 0),
    "box": (box((1, 2, 3)), 0),
    "torus": (torus(), 1),
    "cylinder": (revolved([[1, 0], [1, 2]]), 0),
    "double cone": (revolved([[0, -1], [1, 0], [0, 1]]), 0),
    "pawn": (pawn(), 0),
    "trefoil tube": (trefoil_tube(), 1),
}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_shapes(name):
    mesh, genus = CLOSED[name]
    assert mesh.closed
    assert euler_characteristic(mesh) == 2 - 2 * genus
    assert volume(mesh) > 0
    assert mesh.normal_faces is None


@pytest.mark.parametrize("mesh", [rectangle(2.0, 3.0), plane(4.0, 5), star()], ids=["rectangle", "plane", "star"])
def test_flat_shapes_are_disks_that_face_up(mesh):
    assert not mesh.closed
    assert euler_characteristic(mesh) == 1
    normals = face_normals(mesh)
    assert (normals[:, 2] > 0).all()
    np.testing.assert_array_equal(normals[:, :2], 0)


def test_sphere_converges_to_the_sphere():
    errors = [4 / 3 * np.pi * 8 - volume(sphere(s, radius=2.0)) for s in (2, 3, 4)]
    assert 0 < errors[2] < 0.15
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.1)  # second order
    np.testing.assert_allclose(area(sphere(4)), 4 * np.pi, rtol=5e-3)


def test_sphere_lies_on_the_sphere_and_faces_outwards():
    mesh = sphere(3, radius=2.0, center=(1, 2, 3))
    np.testing.assert_allclose(np.linalg.norm(np.asarray(mesh.vertices) - (1, 2, 3), axis=1), 2, rtol=1e-6)
    outwards = corners(mesh).mean(axis=0) - (1, 2, 3)
    assert (np.sum(face_normals(mesh) * outwards, axis=1) > 0).all()
    assert (np.asarray(dihedral(mesh.edges, mesh.vertices)) < 0).all()


@pytest.mark.parametrize("count", [12, 42, 100, 1000, 10_000])
def test_sphere_has_about_the_number_of_vertices_asked_for(count):
    mesh = sphere(vertex_count=count)
    assert mesh.closed
    n = np.sqrt((count - 2) / 10)
    assert 10 * (n - 0.5) ** 2 + 2 <= len(mesh.vertices) <= 10 * (n + 0.5) ** 2 + 2


def test_subdivisions_are_those_of_an_icosahedron():
    assert [len(sphere(s).faces) for s in range(3)] == [20, 80, 320]


def test_displaced_sphere_stays_in_its_shell_and_has_concave_edges():
    mesh = displaced_sphere(4, amplitude=0.2, radius=3.0)
    distance = np.linalg.norm(mesh.vertices, axis=1)
    assert 3 * 0.8 <= distance.min() < 3 * 0.9 and 3 * 1.1 < distance.max() <= 3 * 1.2
    fold = np.asarray(dihedral(mesh.edges, mesh.vertices))
    assert np.mean(fold > 0) > 0.1 and np.mean(fold < 0) > 0.1


def test_box_area_volume_and_uvs():
    mesh = box((1, 2, 3), center=(5, 6, 7))
    np.testing.assert_allclose(area(mesh), 22, rtol=1e-5)
    np.testing.assert_allclose(volume(mesh), 6, rtol=1e-5)
    np.testing.assert_allclose(np.mean(mesh.vertices, axis=0), (5, 6, 7))
    fold = np.asarray(dihedral(mesh.edges, mesh.vertices))
    assert (fold < 0).sum() == 12 and (fold == 0).sum() == 6  # its edges, and the diagonals of its sides
    a, b, c = np.moveaxis(np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)], 1, 0)
    np.testing.assert_allclose((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0], 1)  # half of [0, 1]² each


def test_rectangle_extent_and_uvs():
    mesh = rectangle(2.0, 3.0, center=(1, 0, 4))
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), (2, 3, 0))
    np.testing.assert_allclose(mesh.uvs, (np.asarray(mesh.vertices)[:, :2] - (0, -1.5)) / (2, 3))


def test_plane_grid():
    mesh = plane(4.0, resolution=5)
    assert len(mesh.faces) == 50
    assert (np.asarray(mesh.edges.kind) == BOUNDARY).sum() == 20
    np.testing.assert_allclose(area(mesh), 16, rtol=1e-6)


def test_torus_closed_forms():
    mesh = torus(2.0, 0.5, 256, 128)
    np.testing.assert_allclose(area(mesh), 4 * np.pi**2 * 2.0 * 0.5, rtol=1e-3)
    np.testing.assert_allclose(volume(mesh), 2 * np.pi**2 * 2.0 * 0.5**2, rtol=1e-3)


def test_trefoil_tube_has_the_volume_of_a_straight_tube():
    t = np.linspace(0, 2 * np.pi, 20_001)
    line = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1) / 3
    length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    np.testing.assert_allclose(volume(trefoil_tube(0.1, 512, 64)), np.pi * 0.1**2 * length, rtol=5e-3)


@pytest.mark.parametrize("profile", [[[1, 0], [1, 2]], [[1, 2], [1, 0]]], ids=["upwards", "downwards"])
def test_cylinder_closed_forms(profile):
    mesh = revolved(profile, segments=256)
    np.testing.assert_allclose(volume(mesh), 2 * np.pi, rtol=1e-3)
    np.testing.assert_allclose(area(mesh), 6 * np.pi, rtol=1e-3)


def test_cone_closed_form():
    np.testing.assert_allclose(volume(revolved([[2, 0], [0, 3]], 256)), 4 * np.pi, rtol=1e-3)


def test_pawn_stands_on_the_ground():
    mesh = pawn()
    np.testing.assert_allclose([np.min(mesh.vertices[:, 2]), np.max(mesh.vertices[:, 2])], [0, 1], atol=1e-6)


def test_star_area():
    mesh = star(5, 2.0, 0.5)
    np.testing.assert_allclose(area(mesh), 10 * 0.5 * 2.0 * 0.5 * np.sin(np.pi / 5), rtol=1e-5)


def test_transformed_moves_and_keeps_outside_outside():
    mesh = box((1, 2, 3)).smooth()
    mirror_and_scale = np.diag([-2.0, 1, 1, 1])
    mirror_and_scale[:3, 3] = (10, 0, 0)
    result = transformed(mesh, mirror_and_scale)
    assert result.closed
    np.testing.assert_allclose(volume(result), 12, rtol=1e-5)
    np.testing.assert_allclose(result.vertices, np.asarray(mesh.vertices) * (-2, 1, 1) + (10, 0, 0))
    # UVs stay with their corners, normals point outwards.
    texture = {
        (f, v): uv
        for f, row in enumerate(np.asarray(mesh.faces))
        for v, uv in zip(row, mesh.uv_faces[f].tolist(), strict=True)
    }
    for f, row in enumerate(np.asarray(result.faces)):
        assert [texture[f, v] for v in row] == result.uv_faces[f].tolist()
    assert (np.sum(np.asarray(result.vertex_normals()) * (np.asarray(result.vertices) - (10, 0, 0)), axis=1) > 0).all()


BAD_ARGUMENTS = {
    "sphere radius": (lambda: sphere(radius=0.0), "sphere: radius must be positive, got 0.0"),
    "sphere count": (lambda: sphere(vertex_count=4), "vertex_count must be at least 12"),
    "sphere subdivisions": (lambda: sphere(-1), "subdivisions must not be negative"),
    "displacement": (lambda: displaced_sphere(amplitude=1.0), "amplitude"),
    "box": (lambda: box((1, 0, 1)), "box: size"),
    "rectangle": (lambda: rectangle(1.0, -1.0), "width and height"),
    "plane": (lambda: plane(resolution=0), "resolution"),
    "torus radii": (lambda: torus(1.0, 2.0), "minor_radius < major_radius"),
    "torus segments": (lambda: torus(major_segments=2), "major_segments must be at least 3"),
    "tube": (lambda: trefoil_tube(0.3), r"radius must be in \(0, 0.2\)"),
    "profile shape": (lambda: revolved([1, 2, 3]), r"shape \[n, 2\]"),
    "one row": (lambda: revolved([[1, 2]]), "at least two rows"),
    "nan profile": (lambda: revolved([[1, 0], [1, np.nan]]), "must be finite"),
    "negative profile": (lambda: revolved([[1, 0], [-1, 1], [1, 2]]), "distances from the axis"),
    "profile touches the axis": (lambda: revolved([[1, 0], [0, 1], [1, 2]]), "distances from the axis"),
    "flat profile": (lambda: revolved([[0, 0], [1, 0]]), "encloses no area"),
    "star": (lambda: star(5, 1.0, 2.0), "inner_radius <= outer_radius"),
    "matrix shape": (lambda: transformed(box(), np.eye(3)), r"shape \[4, 4\]"),
    "projective matrix": (lambda: transformed(box(), np.ones((4, 4))), "last row"),
    "singular matrix": (lambda: transformed(box(), np.diag([1, 1, 0, 1])), "no inverse"),
}


@pytest.mark.parametrize("name", BAD_ARGUMENTS)
def test_bad_arguments(name):
    call, message = BAD_ARGUMENTS[name]
    with pytest.raises(ValueError, match=message):
        call()
