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


CHUNK = 16384
QUICK = {"xla_backend_optimization_level": 0}  # these tests compile much and compute little
_compiled = {}


def call(bsdf, method, *arrays):
    """The method's values [N, ...] as NumPy arrays; compiled once for a kind of model, for any N."""
    if method not in _compiled:
        _compiled[method] = jax.jit(lambda b, *chunk: getattr(b, method)(*chunk), compiler_options=QUICK)
    count = len(arrays[0])
    padded = [np.pad(np.asarray(x), ((0, -count % CHUNK), (0, 0)), mode="edge") for x in arrays]
    parts = [_compiled[method](bsdf, *(x[i : i + CHUNK] for x in padded)) for i in range(0, len(padded[0]), CHUNK)]
    return jax.tree.map(lambda *p: np.concatenate([np.asarray(x) for x in p])[:count], *parts)


def uniform(count, seed):
    return jax.random.uniform(jax.random.key(seed), (count, 2))


def sphere_integral(function, wi, rows=400, columns=320):
    """∫ function(wi, wo) dω over the whole sphere [C] for values [N, C], by midpoints of cells in angles."""
    theta = (np.arange(rows) + 0.5) / rows * np.pi
    phi = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    area = 2 * np.sin(theta) * np.sin(0.5 * np.pi / rows) * 2 * np.pi / columns
    wo = direction(*np.meshgrid(theta, phi, indexing="ij")).astype(np.float32).reshape(-1, 3)
    value = np.asarray(function(repeated(wi, len(wo)), wo), float).reshape(rows, columns, -1)
    return (value * area[:, None, None]).sum((0, 1))


def chi2_test(bsdf, wi, count=50_000, cells=(20, 40), fine=10, seed=0):
    """Whether samples fall into cells of the sphere as often as the density says, where no delta lobe is chosen.

    Cells are even in polar angle and azimuth; the density is integrated by fine x fine midpoints in each. What is
    missing from the density is as often drawn as sampling fails or a delta lobe is chosen.
    """
    many, u = repeated(wi, count), uniform(count, seed)
    wo = np.asarray(call(bsdf, "sample", many, u), float)
    length = np.linalg.norm(wo, axis=-1)
    drawn = length > 0.5
    np.testing.assert_allclose(length[drawn], 1.0, rtol=1e-5)
    assert np.all(wo[~drawn] == 0)
    drawn &= (call(bsdf, "pdf", many, wo) > 0) & (call(bsdf, "sample_delta", many, u).probability == 0)
    wo = wo[drawn]
    rows, columns = cells
    row = np.minimum(np.arccos(np.clip(wo[:, 2], -1, 1)) / np.pi * rows, rows - 1).astype(int)
    column = np.minimum(np.arctan2(wo[:, 1], wo[:, 0]) / (2 * np.pi) % 1 * columns, columns - 1).astype(int)
    counts = np.bincount(row * columns + column, minlength=rows * columns)
    theta = (np.arange(rows * fine) + 0.5) / (rows * fine) * np.pi
    phi = (np.arange(columns * fine) + 0.5) / (columns * fine) * 2 * np.pi
    area = 2 * np.sin(theta) * np.sin(0.5 * np.pi / (rows * fine)) * 2 * np.pi / (columns * fine)
    grid = direction(*np.meshgrid(theta, phi, indexing="ij")).astype(np.float32).reshape(-1, 3)
    density = call(bsdf, "pdf", repeated(wi, len(grid)), grid).astype(float).reshape(rows * fine, columns * fine)
    expected = count * (density * area[:, None]).reshape(rows, fine, columns, fine).sum((1, 3)).ravel()
    assert np.all(counts[expected == 0] == 0)
    rare = expected < 10
    groups = ([*x[~rare], x[rare].sum(), count - x.sum()] for x in (counts, expected))
    observed, expected = (np.asarray(x) for x in groups)
    used = expected > 10
    assert np.all(np.abs(observed - expected)[~used] < 30)
    statistic = np.sum((observed - expected)[used] ** 2 / expected[used])
    assert statistic < chi2.ppf(1 - 1e-5, used.sum() - 1), f"chi² {statistic:.0f} with {used.sum() - 1} degrees"


def check_derivatives(function, arguments, rtol=1e-4, atol=1e-5, step=1e-6):
    """Forward derivatives in every leaf against central differences; call it in float64. Which leaves have any."""
    leaves, structure = jax.tree.flatten(arguments)
    compiled = jax.jit(lambda x, t: jax.jvp(function, x, t), compiler_options=QUICK)
    rng, moves = np.random.default_rng(0), []
    for i, leaf in enumerate(leaves):
        tangents = [jnp.zeros_like(x) for x in leaves]
        tangents[i] = jnp.asarray(rng.normal(size=leaf.shape))
        tangent = jax.tree.unflatten(structure, tangents)
        above, below = (
            compiled(jax.tree.map(lambda x, t, s=s: x + s * t, arguments, tangent), tangent)[0] for s in (step, -step)
        )
        derivative = compiled(arguments, tangent)[1]
        np.testing.assert_allclose(derivative, (above - below) / (2 * step), rtol=rtol, atol=atol)
        moves.append(bool(np.any(derivative != 0)))
    return moves
