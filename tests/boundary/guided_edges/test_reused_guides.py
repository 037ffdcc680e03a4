"""Guides of one position of a shape, used for another: the same program, the same exact derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients.floor_patch import exact, scene
from tests.gradients.floor_point import QUADRANGLE, sheet

BLOCKER = sheet(QUADRANGLE, 0.1)
BOUNDARY = jd.GuidedEdges("grid", "emitter", cells=(64, 4, 4), guide_samples=16, sort=True)
TRACES = []


@jax.jit
def derivative(of, boundary, keys):
    """Of the film's mean by the blocker's vertices, by `render`."""
    TRACES.append(boundary.edges)
    vertices = of.parameters()["blocker.vertices"]

    def mean(vertices, key):
        return jd.render(of.replace({"blocker.vertices": vertices}), key, 512, jd.PathTracer(2, boundary)).mean()

    return jax.lax.map(lambda key: jax.grad(mean)(vertices, key), keys)


def test_moved_shape_has_exact_derivatives():
    """Guides for a blocker that is 0.1 higher and aside; of two positions, and one program."""
    keys = jax.random.split(jax.random.key(1), 6)
    truth = exact(BLOCKER)
    scale = np.abs(truth).max()
    first = None
    for shift in ([0.1, -0.05, 0.1], [0.0, 0.0, 0.0]):
        moved = scene(BLOCKER).replace({"blocker.vertices": jnp.asarray(BLOCKER.vertices) + jnp.asarray(shift)})
        guides = jd.build_guides(moved, BOUNDARY, moving=("blocker",))
        rows = np.asarray(derivative(scene(BLOCKER), guides, keys), float) / scale
        deviation = rows.std(0, ddof=1) / len(keys) ** 0.5
        assert deviation.max() < 0.05, deviation
        wrong = np.abs(rows.mean(0) - truth / scale)
        assert np.all(wrong < 5 * deviation + 1e-6), (wrong, deviation)
        assert first is None or not np.array_equal(rows, first)
        first = rows
    assert len(TRACES) == 1


@pytest.mark.parametrize(
    "boundary",
    [
        BOUNDARY,
        jd.GuidedEdges("kdtree", "mis", leaves=256),
        pytest.param(jd.GuidedEdges("projective", "mis", leaves=512, sort=True), marks=pytest.mark.slow),
    ],
    ids=lambda b: b.guide,
)
def test_refitted_guides_have_exact_derivatives(boundary):
    """Built for a blocker elsewhere and refitted, with the sizes that they had."""
    keys = jax.random.split(jax.random.key(1), 8)
    truth = exact(BLOCKER)
    scale, here = np.abs(truth).max(), scene(BLOCKER)
    moved = here.replace({"blocker.vertices": jnp.asarray(BLOCKER.vertices) + jnp.asarray([0.2, -0.1, 0.1])})
    old = jd.build_guides(moved, boundary, moving=("blocker",))
    new = jd.refit_guides(here, old, jax.random.key(2), moving=("blocker",))
    assert jax.tree.map(jnp.shape, old) == jax.tree.map(jnp.shape, new)
    assert not all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(old), jax.tree.leaves(new), strict=True))
    rows = np.asarray(derivative(here, new, keys), float) / scale
    deviation = rows.std(0, ddof=1) / len(keys) ** 0.5
    assert deviation.max() < 0.05, deviation
    wrong = np.abs(rows.mean(0) - truth / scale)
    assert np.all(wrong < 5 * deviation + 1e-6), (wrong, deviation)


def test_guides_of_another_mesh():
    guides = jd.build_guides(scene(BLOCKER), jd.GuidedEdges(), moving=("blocker",))
    other = scene(jd.shapes.sphere(0))
    with pytest.raises(ValueError, match="build them again with build_guides after remeshing"):
        jax.eval_shape(lambda: jd.derivative_terms(other, jax.random.key(0), 1, jd.PathTracer(2, guides)))
    with pytest.raises(ValueError, match="build_guides: moving names 'ball'"):
        jd.build_guides(scene(BLOCKER), jd.GuidedEdges(), moving=("ball",))
    with pytest.raises(ValueError, match="build them again with build_guides after remeshing"):
        jd.refit_guides(other, guides, jax.random.key(0))
    with pytest.raises(ValueError, match="guides were built for 1 strategies, and this scene at max_depth=3 needs 2"):
        built = jd.build_guides(scene(BLOCKER), jd.GuidedEdges("none", "emitter"), moving=("blocker",))
        jd.refit_guides(scene(BLOCKER), built, jax.random.key(0), max_depth=3)
