"""Trees that handlers find without Python: which are kept, and what happens if one can't be built."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry import queries
from jaxdr.geometry.queries import api
from jaxdr.geometry.queries.embree import native, scene
from jaxdr.kernels import machine

pytestmark = pytest.mark.skipif(not scene.available(), reason="needs Embree")
FACES = jnp.asarray([[0, 1, 2]])
TRIANGLE = np.asarray([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]], np.float32)


@jax.jit
def distance(vertices):
    ray = queries.Rays(jnp.asarray([[0.0, 0.0, 5.0]]), jnp.asarray([[0.0, 0.0, -1.0]]), jnp.asarray([100.0]))
    return queries.closest_hit(queries.Geometry(vertices, FACES), ray, "embree").t[0]


def at(height: float) -> jax.Array:
    return jnp.asarray(TRIANGLE + np.asarray([0.0, 0.0, height]), jnp.float32)


@pytest.fixture
def built(monkeypatch):
    """Heights of the trees that are built or refitted."""
    native.handlers()
    heights = []

    class Counted(scene.EmbreeScene):
        def _commit(self, vertices, quality):
            heights.append(float(vertices[0, 2]))
            super()._commit(vertices, quality)

    monkeypatch.setattr(native, "EmbreeScene", Counted)
    return heights


def test_a_tree_in_use_stays(built):
    """A target that is rendered in every step keeps its tree, though Python does not see its uses."""
    still = 0.25 + 2**-10  # no other test has a tree of this height
    for step in range(1, 9):
        assert distance(at(still)) == pytest.approx(5.0 - still, rel=1e-6)
        assert distance(at(still + step / 16)) == pytest.approx(5.0 - still - step / 16, rel=1e-6)
    assert built.count(still) == 1 and len(built) == 9


def test_moved_vertices_have_trees_of_their_own(built):
    heights = np.random.default_rng(0).integers(0, 64, 40) / 32
    for height in heights:
        assert distance(at(float(height))) == pytest.approx(5.0 - height, rel=1e-6)


def test_programs_call_handlers_of_this_version():
    """XLA keeps programs for other processes, which may have other handlers."""
    name = native.handlers().names["jaxdr_closest_hit"]
    assert re.fullmatch("jaxdr_closest_hit_[0-9a-f]{12}", name) and name in distance.lower(at(0.0)).as_text()


def test_a_tree_that_cannot_be_built(monkeypatch, capfd):
    def refuse(*_):
        raise MemoryError("no room for a tree")

    monkeypatch.setattr(native, "EmbreeScene", refuse)
    monkeypatch.setattr(scene.EmbreeScene, "refit", refuse)
    with pytest.raises((ValueError, jax.errors.JaxRuntimeError), match="Embree's tree of a mesh can't be built"):
        distance(at(1.0 + 1 / 1024)).block_until_ready()
    assert "no room for a tree" in capfd.readouterr().err
    monkeypatch.undo()
    assert distance(at(1.0)) == pytest.approx(4.0, rel=1e-6)  # other programs go on


def test_without_a_compiler_warp_traces_rays(monkeypatch):
    def refuse():
        raise machine.CompilerError("no compiler")

    monkeypatch.setattr(native, "handlers", refuse)
    with pytest.warns(UserWarning, match="Warp traces rays in place of Embree, which is faster: no compiler"):
        assert api._module("auto").__name__.endswith("warp.queries")
