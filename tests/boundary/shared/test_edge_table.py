"""Edges that bundles of rays may cross: those that the tree finds against all of them, and how they are drawn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr import sizes
from jaxdr.boundary.shared.edge_table import edge_table
from jaxdr.geometry.bundles import Bundles, may_cross
from jaxdr.geometry.queries import draw_edges
from jaxdr.geometry.shapes import displaced_sphere
from jaxdr.scene.packed import pack

REACH = 2.0
BUNDLES, COPIES = 63, 65  # two blocks of 2048 on a CPU


def scene_and_bundles():
    """Two bumpy spheres, and rays that pass through and by them."""
    ball = displaced_sphere(1)
    shapes = {
        "one": jd.Shape(ball),
        "two": jd.Shape(jd.Mesh(0.3 * np.asarray(ball.vertices) + [1.5, 0, 0], ball.faces)),
    }
    camera = jd.Perspective(jd.look_at([0, -5, 0], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 8))
    packed = pack(jd.Scene(shapes, camera, None))
    rng = np.random.default_rng(0)
    origin = rng.normal(size=(BUNDLES, 3)) * 0.3 + [0, -4, 0]
    direction = rng.normal(size=(BUNDLES, 3)) * 0.7 - origin
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    rates = rng.normal(size=(2, BUNDLES, 3)) * 0.02
    end = rng.uniform(2.0, 8.0, BUNDLES)
    return packed, Bundles(*(jnp.asarray(x, jnp.float32) for x in (origin, direction, *rates, end)))


@jax.jit
def importances(table, bundles):
    """Of every edge for every bundle, zero for those that are no candidates [N, E]."""
    each = jax.tree.map(lambda x: x[:, None], bundles)
    start = jnp.broadcast_to(table.ends[None, :, 0], (BUNDLES, *table.ends[:, 0].shape))
    _, crosses = may_cross(each, start, table.ends[None, :, 1] - start, REACH)
    front = jnp.einsum("ekx,nx->nek", table.normals, bundles.direction) > 0
    silhouette = ~table.interior | (front[..., 0] != front[..., 1])
    return jnp.where(crosses & (table.importance > 0), jnp.where(silhouette, 1.0, table.importance), 0.0)


@pytest.mark.parametrize(("rays", "platform"), [("warp", "cpu"), ("jax", "cpu"), ("jax", "gpu")])
def test_all_candidates_and_each_as_often_as_it_should(rays, platform, monkeypatch):
    """In two blocks, and in one as on a GPU."""
    monkeypatch.setattr(sizes, "platform", lambda: platform)
    packed, bundles = scene_and_bundles()
    table = jax.jit(lambda: edge_table(packed, packed.edges.shape >= 0, "jax"))()
    expected = np.asarray(importances(table, bundles))
    assert (expected > 0).sum() > 2 * BUNDLES
    rows = np.repeat(np.arange(BUNDLES), COPIES)
    active, bundles = jnp.asarray(rows % 7 != 0), jax.tree.map(lambda x: x[rows], bundles)
    seed = jax.random.bits(jax.random.key(0), rows.shape, jnp.uint32)
    bundles = bundles._replace(end=jnp.where(active, bundles.end, 0.0))
    drawn = jax.jit(lambda *arguments: draw_edges(*arguments, REACH, rays))  # traced for this platform
    found = jax.tree.map(np.asarray, drawn(table, bundles, seed))
    some = found.total > 0
    np.testing.assert_array_equal(some, np.asarray(active) & (expected.sum(1) > 0)[rows])
    np.testing.assert_allclose(found.total[some], expected.sum(1)[rows][some], rtol=1e-5)
    np.testing.assert_allclose(found.importance[some], expected[rows, found.edge][some], rtol=1e-6)
    counts = np.zeros_like(expected)
    np.add.at(counts, (rows[some], found.edge[some]), 1)
    used = np.unique(rows[some])
    share = expected[used] / expected[used].sum(1, keepdims=True)
    deviation = np.sqrt(COPIES * share * (1 - share))
    many = deviation > 2  # counts of rarer edges are far from normally distributed
    z = (counts[used] - COPIES * share)[many] / deviation[many]
    assert len(z) > 50 and np.abs(z).max() < 5 and abs(z.std() - 1) < 0.25


def test_flat_and_still_edges_are_left_out():
    square = jd.Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    camera = jd.Perspective(jd.look_at([0, -5, 0], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 8))
    packed = pack(jd.Scene({"a": jd.Shape(square), "b": jd.Shape(square)}, camera, None))
    table = edge_table(packed, packed.edges.shape == 1, "jax")
    diagonal = np.sort(np.asarray(packed.edges.vertices) % 4, axis=1).tolist()
    expected = [shape == 1 and pair != [0, 2] for shape, pair in zip(packed.edges.shape, diagonal, strict=True)]
    np.testing.assert_array_equal(table.importance > 0, expected)
