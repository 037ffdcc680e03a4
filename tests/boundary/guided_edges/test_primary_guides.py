"""Guides over the unit cube: what is drawn has the density that is reported, and that integrates to one."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.boundary.guided_edges.kdtree_guide import KdTree, build_kdtree, root_borders
from jaxdr.boundary.guided_edges.primary_guides import SHARES, Defended, build_grid, defended, grid_of
from jaxdr.boundary.guided_edges.seeded_tree import SeededTree, build_seeded_tree


def target(p):
    """Smooth, with a ridge and a part where there is nothing."""
    x, y, z = p.T
    return jnp.where(y < 0.6, x * x + jnp.exp(-40 * (y - 0.3 * z) ** 2) * (z > 0.2), 0.0)


def moved(p):
    """The target of a shape that has moved since."""
    return target((p + jnp.asarray([0.1, 0.15, -0.1])) % 1.0)


def guides(target):
    borders = root_borders(jnp.asarray([0.1, 0.1, 0.35, 0.7, 1.0]), 16)
    seeds = jax.random.uniform(jax.random.key(1), (256, 3))
    usable = jnp.arange(256) % 2 == 0
    return {
        "projective": build_seeded_tree(target, seeds, usable, 8, 256, 16, jax.random.key(0)),
        "grid": build_grid(target, (8, 6, 5), 4, jax.random.key(0)),
        "kdtree": build_kdtree(target, borders, 1024, 32, 0.01),
    }


def guarded(guide):
    """With the least share of samples without it."""
    return Defended(guide, jnp.asarray(SHARES[0], float))


GUIDES = "grid", "kdtree", "projective"


@pytest.fixture(scope="module", params=(*GUIDES, *(f"{name}, refitted" for name in GUIDES)))
def guide(request):
    """Built for the target, or built for another and refitted."""
    name, *refitted = request.param.split(", ")

    def made():
        samples = {"grid": 4, "kdtree": 32, "projective": 16}[name]
        if not refitted:
            return guides(target)[name]
        return guides(moved)[name].refitted(target, samples, jax.random.key(2))

    with jax.enable_x64(True):
        return jax.jit(made)()


def boxes(guide):
    """Boxes (lower, upper) in which the density is constant or trilinear."""
    if isinstance(guide, KdTree):
        used = np.asarray(guide.leaves.probability(jnp.arange(guide.first.shape[0]))) > 0
        assert used.sum() > 100
        return guide.nodes.lower[used], guide.nodes.upper[used]
    if isinstance(guide, SeededTree):
        # Cells, cut along the sides of the boxes in them.
        cuts = jnp.stack([guide.cell_lower, guide.lower, guide.upper, guide.cell_upper])
        parts = jnp.asarray(list(np.ndindex(3, 3, 3)))
        lower, upper = (cuts[parts + k, :, jnp.arange(3)] for k in (0, 1))
        return tuple(jnp.moveaxis(a, 1, -1).reshape(-1, 3) for a in (lower, upper))
    size = (guide.x.shape[1], guide.y.shape[1], guide.z.shape[1])
    cell = jnp.stack(jnp.meshgrid(*map(jnp.arange, size), indexing="ij"), -1).reshape(-1, 3)
    return cell / jnp.asarray(size), (cell + 1) / jnp.asarray(size)


def test_density_integrates_to_one(guide):
    """Two-point Gauss quadrature in every box, exact for what is linear along each axis; the boxes fill the cube."""
    with jax.enable_x64(True):
        lower, upper = boxes(guide)
        assert abs(float((upper - lower).prod(-1).sum()) - 1) < 1e-6
        nodes = 0.5 + jnp.asarray(np.stack(np.meshgrid(*[[-1, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)) / 12**0.5
        points = lower[:, None] + nodes * (upper - lower)[:, None]
        weight = (upper - lower).prod(-1) / 8
        for pdf in (guide.pdf, partial(guarded(guide).pdf, count=1000)):
            total = (jax.jit(pdf)(points.reshape(-1, 3)).reshape(-1, 8).sum(-1) * weight).sum()
            assert abs(float(total) - 1) < 1e-6


def test_samples_have_the_density(guide):
    """The mean of f / p over samples is the integral of f, for f of several frequencies; 1 / p has the mean 1."""
    with jax.enable_x64(True):
        u = jax.random.uniform(jax.random.key(1), (1 << 14, 3))
        points = jax.jit(guarded(guide).sample)(u)
        pdf = jax.jit(partial(guarded(guide).pdf, count=u.shape[0]))(points)
        assert float(points.min()) >= 0 and float(points.max()) < 1
        points, pdf = np.asarray(points), np.asarray(pdf)
        waves = np.array(list(np.ndindex(3, 3, 3)))
        f = np.cos(np.pi * points[:, None] * waves).prod(-1) / pdf[:, None]
        wrong = f.mean(0) - (waves == 0).all(1)
        assert np.all(np.abs(wrong) < 4.5 * f.std(0) / u.shape[0] ** 0.5), wrong


def test_guides_follow_the_target(guide):
    """The variance of target / density is a fraction of the target's own."""
    with jax.enable_x64(True):
        u = jax.random.uniform(jax.random.key(2), (1 << 13, 3))

        @jax.jit
        def deviations(guide, u):
            guided = guarded(guide).sample(u)
            return (target(guided) / guarded(guide).pdf(guided, u.shape[0])).std(), target(u).std()

        guided, unguided = deviations(guide, u)
        assert float(guided) < 0.7 * float(unguided)


@pytest.mark.parametrize("name", GUIDES)
def test_refitting_follows_what_moved(name):
    """Less variance than with the guide as it was."""
    with jax.enable_x64(True):
        u = jax.random.uniform(jax.random.key(2), (1 << 13, 3))

        @jax.jit
        def deviation(guide):
            drawn = guarded(guide).sample(u)
            return (target(drawn) / guarded(guide).pdf(drawn, u.shape[0])).std()

        old = jax.jit(lambda: guides(moved)[name])()
        new = jax.jit(lambda old: old.refitted(target, 16, jax.random.key(3)))(old)
        assert float(deviation(new)) < 0.8 * float(deviation(old))


@pytest.mark.parametrize("missed, share", [(0.0, 0.1), (0.25, 0.4), (1.0, 1.0)])
def test_share_without_a_guide_is_the_best_one(missed, share):
    """A guide that draws from one half, of a target that is 1 there and e elsewhere: 0.5 / (2 - s) + 0.5 e^2 / s is
    least at s = 2 e / (1 + e)."""
    half = grid_of(jnp.asarray([1.0, 0.0])[:, None, None])
    found = defended(half, lambda p: jnp.where(p[:, 0] < 0.5, 1.0, missed), jax.random.key(0), float)
    assert abs(float(found.share) - share) < 0.01
