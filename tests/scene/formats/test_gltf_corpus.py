"""The corpus of small glTF files: each gives the triangles, places, warnings and errors that the specification says."""

import os
import subprocess
import sys
import warnings

import numpy as np
import pytest
import trimesh

from experiments.real_scenes import gltf_corpus
from jaxdr.geometry.load import load_mesh
from jaxdr.scene.formats.gltf.load import load_gltf

PACKAGES = {"draco.glb": "DracoPy", "meshopt.glb": "meshoptimizer"}
MANY = "many_nodes.glb"  # slow with run-time type checks: in a process of its own
NAMES = [case.name for case, _ in gltf_corpus.CASES if case.name != MANY]
# What trimesh reads as the specification says.
TRIMESH = (
    *("data_uri.gltf", "mirrored.glb", "strip.glb", "quantized.glb", "draco.glb"),
    *("colors_u8.glb", "second_uvs.glb", "lights.glb"),
)


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    return {case.name: case for case in gltf_corpus.write(tmp_path_factory.mktemp("corpus"))}


def corners(scene):
    """All triangles of a scene [F, 3, 3]."""
    meshes = [shape.mesh for shape in scene.shapes.values()]
    return np.concatenate([np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)] for mesh in meshes])


def load(case, **options):
    """(scene, messages)."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        return load_gltf(case.path, **options), [str(warning.message) for warning in caught]


@pytest.mark.parametrize("name", NAMES)
def test_a_file_of_the_corpus(cases, name):
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name])
    case = cases[name]
    if case.error is not None:
        for ignore in (False, True):
            with pytest.raises(ValueError) as caught:
                load_gltf(case.path, ignore_unsupported=ignore)
            assert str(caught.value).startswith(f"{case.path}: ") and case.error in str(caught.value)
        return
    if not case.strict:
        with pytest.raises(ValueError) as caught:
            load_gltf(case.path)
        assert any(words in str(caught.value) for words in case.warned)
    scene, messages = load(case, ignore_unsupported=not case.strict)
    triangles = corners(scene)
    assert len(triangles) == case.triangles
    np.testing.assert_allclose(triangles.min((0, 1)), case.lower, atol=1e-4)
    np.testing.assert_allclose(triangles.max((0, 1)), case.upper, atol=1e-4)
    a, b, c = np.moveaxis(triangles, 1, 0)
    if case.volume is not None:
        assert all(shape.mesh.closed for shape in scene.shapes.values())
        np.testing.assert_allclose(np.sum(a * np.cross(b, c)) / 6, case.volume, rtol=1e-3)
    elif case.upper[2] == 0:
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()  # a plane that faces +z
    assert len(messages) == len(case.warned)
    for words in case.warned:
        assert any(words in message and message.startswith((f"{case.path}: ", "Mesh: ")) for message in messages)


@pytest.mark.parametrize("name", TRIMESH)
def test_the_same_triangles_as_trimesh(cases, name):
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name])
    scene = load(cases[name])[0]
    expected = trimesh.load_scene(cases[name].path, process=False).to_mesh().triangles
    found = corners(scene)

    def ordered(triangles):
        rounded = np.round(triangles.reshape(len(triangles), 9), 3) + 0.0
        return rounded[np.lexsort(rounded.T)]

    def from_least(triangles):
        """Each triangle from its least corner on."""
        key = triangles @ [1.0, 1e3, 1e6]
        start = key.argmin(1)[:, None]
        return np.take_along_axis(triangles, ((start + np.arange(3)) % 3)[..., None], 1)

    np.testing.assert_allclose(ordered(from_least(found)), ordered(from_least(expected)), atol=2e-3)


LOAD_ALL = """
import sys, time, warnings
import jaxdr as jd
warnings.simplefilter("ignore")
many, *others = sys.argv[1:]
for path in others:
    jd.load_gltf(path, ignore_unsupported=True)
start = time.perf_counter()
scene = jd.load_gltf(many)
print(len(scene.shapes), time.perf_counter() - start)
"""


def test_3000_nodes_are_loaded_in_seconds_and_nothing_is_compiled(cases):
    others = [str(case.path) for case in cases.values() if case.error is None and case.name != MANY]
    done = subprocess.run(
        [sys.executable, "-c", LOAD_ALL, str(cases[MANY].path), *others],
        env={**os.environ, "JAX_LOG_COMPILES": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    shapes, seconds = done.stdout.split()
    assert int(shapes) == 3000 and float(seconds) < 30  # 4 s on two cores, however busy they are
    assert "Compiling" not in done.stderr


MESHES = (
    *("instances.glb", "instances_quantized.glb", "mirrored.glb", "hidden.glb", "strip.glb", "fan.glb", "sparse.glb"),
    *("quantized.glb", "quantized_normalized.glb", "morphed.glb", "skinned.glb", "draco.glb", "meshopt.glb"),
)


@pytest.mark.parametrize("name", MESHES)
def test_load_mesh_reads_the_same_triangles(cases, name):
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name])
    case, mesh = cases[name], load_mesh(cases[name].path)
    assert mesh.faces.shape[0] == case.triangles
    np.testing.assert_allclose(np.asarray(mesh.vertices).min(0), case.lower, atol=1e-4)
    np.testing.assert_allclose(np.asarray(mesh.vertices).max(0), case.upper, atol=1e-4)


def test_load_mesh_refuses_what_may_change_the_mesh(cases):
    path = cases["unknown_extensions.glb"].path
    with pytest.raises(ValueError, match=r"load_mesh: .*extensions\.glb: .*EXT_a is required, and not supported"):
        load_mesh(path)
