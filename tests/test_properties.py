"""What holds for any mesh, transform, config and scene file, tried on random ones; cheap."""

import dataclasses
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.optimize.config import OptimizeConfig, Target, optimize_config
from jaxdr.optimize.reconstruction.config import ReconstructConfig, reconstruct_config
from jaxdr.scene.camera import look_at
from jaxdr.scene.formats.mitsuba.document import read_document

FEW = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
NUMBERS = st.floats(-5.0, 5.0).map(lambda x: round(x, 3))
POINTS = st.tuples(NUMBERS, NUMBERS, NUMBERS)
NAMES = st.text("abcdefgh_", min_size=1, max_size=8)


@st.composite
def soups(draw):
    """Vertices and faces of any kind of surface, open, branching or with faces that lie on one another."""
    count = draw(st.integers(3, 8))
    vertices = np.array(draw(st.lists(POINTS, min_size=count, max_size=count)))
    corners = st.permutations(range(count)).map(lambda order: order[:3])
    return vertices, np.array(draw(st.lists(corners, min_size=1, max_size=6)))


@pytest.mark.filterwarnings("ignore")
@FEW
@given(soups())
def test_edges_of_any_mesh_are_those_of_its_faces(soup):
    vertices, faces = soup
    try:
        mesh = jd.Mesh(vertices, faces)
    except ValueError as problem:
        assert "area" in str(problem)
        return
    faces, edges = np.asarray(mesh.faces), mesh.edges
    sides = {frozenset(side) for face in faces for side in (face[:2], face[1:], face[[2, 0]])}
    assert {frozenset(edge) for edge in np.asarray(edges.vertices).tolist()} == {frozenset(map(int, s)) for s in sides}
    for ends, beside, opposite in zip(*map(np.asarray, (edges.vertices, edges.faces, edges.opposite)), strict=True):
        for face, corner in zip(beside, opposite, strict=True):
            if face >= 0:
                assert set(faces[face].tolist()) == {*ends.tolist(), int(corner)}
    assert mesh.closed <= (len(faces) % 2 == 0)  # every edge has two faces, every face three edges


@FEW
@given(POINTS, POINTS, POINTS)
def test_a_camera_looks_where_it_is_told(origin, target, up):
    try:
        matrix = look_at(origin, target, up)
    except ValueError as problem:
        assert "parallel" in str(problem)
        return
    axes = matrix[:3, :3]
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-6)
    assert np.linalg.det(axes) > 0
    towards = np.subtract(target, origin)
    np.testing.assert_allclose(axes.T @ towards, [0, 0, np.linalg.norm(towards)], atol=1e-5)
    assert axes[:, 1] @ up > 0


@FEW
@given(POINTS, POINTS)
def test_a_moved_mesh_keeps_its_shape(origin, target):
    if np.linalg.norm(np.cross(np.subtract(target, origin), (0, 0, 1))) < 1e-3:
        return
    matrix, box = look_at(origin, target, (0, 0, 1)), shapes.box((1.0, 2.0, 3.0))
    there = shapes.transformed(box, matrix)
    back = shapes.transformed(there, np.linalg.inv(matrix))
    np.testing.assert_allclose(back.vertices, box.vertices, atol=1e-5)
    assert there.closed and np.array_equal(there.faces, box.faces)


@FEW
@given(st.dictionaries(NAMES, NUMBERS, min_size=1, max_size=3), st.sampled_from(["", "optimizer", "report", "samples"]))
def test_no_config_takes_what_it_does_not_know(unknown, table):
    """The message names the key."""
    known = {field.name for part in (OptimizeConfig, Target) for field in dataclasses.fields(part)}
    unknown = {f"{name}_z": value for name, value in unknown.items() if f"{name}_z" not in known}
    config: dict = {"output": "out", "target": {"shape": "sphere"}}
    config |= {table: unknown} if table else unknown
    with pytest.raises(ValueError) as problem:
        optimize_config(config, Path("run.toml"))
    assert any(name in str(problem.value) for name in unknown)


@FEW
@given(st.sampled_from(["priors", "rates", "samples"]), st.integers(-5, 5), st.data())
def test_numbers_of_a_config_are_taken_or_refused_by_name(table, value, data):
    part = getattr(ReconstructConfig("photos", "out"), table)
    name = data.draw(st.sampled_from([field.name for field in dataclasses.fields(part)]))
    least = {"priors": 0, "rates": 1, "samples": 1}[table]
    made = {table: {name: value}}
    if value >= least:
        config = reconstruct_config(made, "settings.toml", "photos", "out")
        assert getattr(getattr(config, table), name) == value
    else:
        with pytest.raises(ValueError, match=f"settings.toml: {table}.{name}: must"):
            reconstruct_config(made, "settings.toml", "photos", "out")


def scene_file(path, body):
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


@FEW
@given(values=st.dictionaries(NAMES, NUMBERS, min_size=1, max_size=4), given=st.data())
def test_variables_of_a_mitsuba_file(tmp_path, values, given):
    """Those that are given take the place of defaults."""
    changed = given.draw(st.dictionaries(st.sampled_from(sorted(values)), NUMBERS))
    defaults = "".join(f'<default name="{name}" value="{value}"/>' for name, value in values.items())
    used = "".join(f'<float name="{name}" value="${name}"/>' for name in values)
    if any(one != other and other.startswith(one) for one in values for other in values):
        return  # which of both a $name means is for the reader to say
    root = read_document(scene_file(tmp_path / "scene.xml", defaults + f'<bsdf type="any">{used}</bsdf>'), changed)
    bsdf = next(child for child in root.children if child.tag == "bsdf")
    found = {child.attributes["name"]: float(child.attributes["value"]) for child in bsdf.children}
    assert found == values | changed


@FEW
@given(POINTS, st.floats(10.0, 120.0), st.integers(1, 64), st.integers(1, 64))
def test_a_camera_of_a_mitsuba_file(tmp_path, origin, fov, width, height):
    if math.hypot(*origin[:2]) < 0.1:
        return
    where = ", ".join(map(str, origin))
    body = f"""<sensor type="perspective"><float name="fov" value="{fov}"/>
    <transform name="to_world"><lookat origin="{where}" target="0, 0, 0" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/></film>
    </sensor><shape type="cube" id="box"/><emitter type="constant"/>"""
    camera = jd.load_mitsuba(scene_file(tmp_path / "scene.xml", body)).camera
    np.testing.assert_allclose(camera.to_world, look_at(origin, (0, 0, 0), (0, 0, 1)), atol=1e-5)
    assert float(camera.fov) == pytest.approx(fov) and (camera.film.width, camera.film.height) == (width, height)


@FEW
@given(st.recursive(st.just(()), lambda inner: st.lists(inner, max_size=3).map(tuple), max_leaves=6), NAMES)
def test_a_mitsuba_file_is_read_or_refused(tmp_path, tree, tag):
    """Whatever elements it has: a scene, or a `ValueError`."""

    def element(children):
        made = ElementTree.Element(tag, {"type": tag})
        made.extend(map(element, children))
        return made

    body = ElementTree.tostring(element(tree), encoding="unicode")
    with pytest.raises(ValueError, match=r"scene\.xml"):
        jd.load_mitsuba(scene_file(tmp_path / "scene.xml", body))
