"""Directions, grids over the sphere and the checks that every model of a BSDF has to pass."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2


def direction(theta, phi):
    """Unit vectors at polar angle theta and azimuth phi (radians)."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def random_directions(count, seed, lowest=-1.0):
    """Unit vectors [count, 3], uniform in solid angle where z is in [lowest, 1]."""
    rng = np.random.default_rng(seed)
    return jnp.asarray(direction(np.arccos(rng.uniform(lowest, 1, count)), rng.uniform(0, 2 * np.pi, count)), float)


def repeated(wi, count):
    return jnp.broadcast_to(jnp.asarray(wi, float), (count, 3))


def uniform(count, seed):
    return jax.random.uniform(jax.random.key(seed), (count, 2))


def sphere_integral(function, wi, rows=1200, columns=600):
    """∫ function(wi, wo) dω over the whole sphere, by midpoints of cells in (cos θ, φ) that are finest at the poles.

    With z = sin(t), t even, and sin² over half azimuths, no cell is larger than a lobe of roughness 0.1.
    """
    t = ((np.arange(rows) + 0.5) / rows - 0.5) * np.pi
    phi = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    area = np.cos(t) * np.pi / rows * 2 * np.pi / columns
    t, phi = np.meshgrid(t, phi, indexing="ij")
    wo = jnp.asarray(direction(np.pi / 2 - t, phi), float).reshape(-1, 3)
    value = np.asarray(function(repeated(wi, wo.shape[0]), wo), float).reshape(rows, columns, -1)
    return (value * area[:, None, None]).sum((0, 1)).squeeze()


def chi2_test(sample, pdf, wi, count=60_000, cells=(24, 48), fine=16, seed=0):
    """Whether samples fall into cells of the sphere as often as the density says; those that fail are zero vectors.

    Cells are even in polar angle and azimuth; the density is integrated by fine x fine midpoints in each.
    """
    wo = np.asarray(sample(repeated(wi, count), uniform(count, seed)), float)
    length = np.linalg.norm(wo, axis=-1)
    drawn = length > 0.5
    np.testing.assert_allclose(length[drawn], 1.0, rtol=1e-5)
    assert np.all(wo[~drawn] == 0)
    wo = wo[drawn & (np.asarray(pdf(repeated(wi, count), jnp.asarray(wo, float))) > 0)]
    rows, columns = cells
    row = np.minimum(np.arccos(np.clip(wo[:, 2], -1, 1)) / np.pi * rows, rows - 1).astype(int)
    column = np.minimum(np.arctan2(wo[:, 1], wo[:, 0]) / (2 * np.pi) % 1 * columns, columns - 1).astype(int)
    counts = np.bincount(row * columns + column, minlength=rows * columns)
    theta = (np.arange(rows * fine) + 0.5) / (rows * fine) * np.pi
    phi = (np.arange(columns * fine) + 0.5) / (columns * fine) * 2 * np.pi
    area = 2 * np.sin(theta) * np.sin(0.5 * np.pi / (rows * fine)) * 2 * np.pi / (columns * fine)
    grid = jnp.asarray(direction(*np.meshgrid(theta, phi, indexing="ij")), float).reshape(-1, 3)
    density = np.asarray(pdf(repeated(wi, grid.shape[0]), grid), float).reshape(rows * fine, columns * fine)
    density *= area[:, None]
    expected = count * density.reshape(rows, fine, columns, fine).sum((1, 3)).ravel()
    rare = expected < 10
    assert np.all(counts[expected == 0] == 0)
    pooled = np.append(counts[~rare], counts[rare].sum()), np.append(expected[~rare], expected[rare].sum())
    # What is missing from the density is as often drawn as sampling fails.
    observed, expected = (np.append(x, count - x.sum()) for x in pooled)
    used = expected > 5
    assert abs(observed[~used].sum() - expected[~used].sum()) < 5 * np.sqrt(max(expected[~used].sum(), 1)) + 5
    statistic = np.sum((observed - expected)[used] ** 2 / expected[used])
    assert statistic < chi2.ppf(1 - 1e-5, used.sum() - 1), f"chi² {statistic:.0f} with {used.sum() - 1} degrees"


def assert_finite_gradients(bsdf, wi, wo):
    """eval and pdf, and their derivatives in all fields and both directions, are finite."""

    def total(bsdf, wi, wo):
        return bsdf.eval(wi, wo).sum() + bsdf.pdf(wi, wo).sum()

    value, gradients = jax.value_and_grad(total, argnums=(0, 1, 2))(bsdf, wi, wo)
    assert np.isfinite(value)
    for leaf in jax.tree.leaves(gradients):
        assert np.all(np.isfinite(leaf))


def fields(bsdf, dtype):
    """The model with its fields, and arrays beside it, in another precision."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), bsdf)
