"""Transmittance and internal reflectance of a rough dielectric coat: integrals over its facets, read from tables.

The tables are in `coat.npz`; `python -m jaxdr.scene.bsdf.coat` computes them anew.
"""

import functools
import itertools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.geometry.vector import dot, from_components, z_of
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric
from jaxdr.scene.bsdf.microfacet import DISTRIBUTIONS, reflect, refract

FILE = Path(__file__).with_name("coat.npz")
# Axes of the tables: lowest value, highest value, number of nodes. Nodes are equidistant in 1 / eta and in the square
# roots of alpha and of the cosine: there is a boundary layer where both of these are small.
ALPHA, INVERSE_ETA, COSINE = (1e-4, 1.0, 20), (0.4, 1.0, 9), (0.0, 1.0, 32)
HIGHEST_ETA = 1.0 / INVERSE_ETA[0]


def transmittance(
    distribution: str, alpha: Float[Array, "*#n"], eta: Float[Array, "*#n"], cosine: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Share of the light at `cosine` ≥ 0 to the normal that a coat refracts, scattered once; `eta` in [1, 2.5].

    It is the integral of Walter et al. 2007, Eq. 21, over outgoing directions, without the scaling of radiance. The
    error is below 0.01.
    """
    places = _place(ALPHA, _root(alpha)), _place(INVERSE_ETA, 1.0 / eta), _place(COSINE, _root(cosine))
    return _interpolate(_table(f"transmittance {distribution}"), places)


def internal_reflectance(distribution: str, alpha: Float[Array, "*#n"], eta: Float[Array, "*#n"]) -> Float[Array, "*n"]:
    """Share of diffuse light from inside that a coat reflects, scattered once; `eta` in [1, 2.5].

    It is the integral of Walter et al. 2007, Eq. 20, over the directions of both arriving and reflected light.
    """
    places = _place(ALPHA, _root(alpha)), _place(INVERSE_ETA, 1.0 / eta)
    return _interpolate(_table(f"internal reflectance {distribution}"), places)


@functools.cache
def _table(name: str) -> Float[np.ndarray, "..."]:
    with np.load(FILE) as tables:
        return tables[name]


def _root(x):
    """Square root; its derivative at zero, which is infinite, is taken as zero."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def _ends(axis):
    low, high, count = axis
    return (low, high, count) if axis is INVERSE_ETA else (low**0.5, high**0.5, count)


def _place(axis, value):
    """(index of the node before, share of the way to the next one); end intervals are extrapolated beyond the table."""
    low, high, count = _ends(axis)
    place = (value - low) / (high - low) * (count - 1)
    node = jnp.clip(jnp.floor(place), 0, count - 2)
    return node.astype(jnp.int32), place - jax.lax.stop_gradient(node)


def _interpolate(table, places):
    """Multilinear interpolation."""
    dtype = places[0][1].dtype
    flat, strides = jnp.asarray(table.ravel(), dtype), np.cumprod([1, *table.shape[:0:-1]])[::-1]
    first = sum(int(stride) * node for stride, (node, _) in zip(strides, places, strict=True))
    total = jnp.zeros((), dtype)
    for corner in itertools.product((0, 1), repeat=len(places)):
        weight = jnp.ones((), dtype)
        for step, (_, share) in zip(corner, places, strict=True):
            weight = weight * (share if step else 1.0 - share)
        total = total + weight * flat[first + int(np.dot(strides, corner))]
    return total


def compute_transmittance(distribution: str, alpha, eta, cosine, nodes=(40, 24)) -> Float[Array, "*n 2"]:
    """(refracted, reflected) share of light at `cosine` > 0, by quadrature over visible facets.

    `eta` is the index beyond the coat over the one on this side. The quadrature is Gauss-Legendre in both random
    numbers, with denser nodes at the ends, where the slopes are large. By symmetry only half of the range of the second
    number is needed.
    """
    axes = []
    for count in nodes:
        x, weight = np.polynomial.legendre.leggauss(count)
        x, weight = 0.5 * (x + 1.0), 0.5 * weight
        axes.append((x * x * (3.0 - 2.0 * x), weight * 6.0 * x * (1.0 - x)))
    (first, first_weight), (second, second_weight) = axes
    u = jnp.asarray(np.stack(np.meshgrid(first, 0.5 * second, indexing="ij"), -1).reshape(-1, 2))
    weights = jnp.asarray(np.outer(first_weight, second_weight).ravel())
    model = DISTRIBUTIONS[distribution]
    wi = from_components(jnp.sqrt(1.0 - cosine * cosine), jnp.zeros_like(cosine), cosine)[..., None, :]
    alpha, eta = alpha[..., None], eta[..., None]
    m = model.sample(wi, alpha, u)
    through, passes = refract(wi, m, eta)
    back = reflect(wi, m)
    fresnel = fresnel_dielectric(jnp.abs(dot(wi, m)), eta).reflectance
    refracted = jnp.where(passes & (z_of(through) < 0), (1.0 - fresnel) * -z_of(through), 0.0)
    reflected = jnp.where(z_of(back) > 0, fresnel * z_of(back), 0.0)
    shares = refracted * model.masking(through, alpha), reflected * model.masking(back, alpha)
    return jnp.stack([(weights * share).sum(-1) for share in shares], -1)


def compute_tables() -> dict[str, Any]:
    """All tables, in float32, computed in float64. It takes about a minute."""
    tables: dict[str, Any] = {}
    nodes, weights = np.polynomial.legendre.leggauss(300)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    with jax.enable_x64(True):
        roots = {axis: np.linspace(*_ends(axis)) for axis in (ALPHA, INVERSE_ETA, COSINE)}
        alphas, indices, cosines = roots[ALPHA] ** 2, 1.0 / roots[INVERSE_ETA], np.maximum(roots[COSINE] ** 2, 1e-6)
        for name in DISTRIBUTIONS:
            compute = jax.jit(functools.partial(compute_transmittance, name))
            rows = [[(jnp.asarray(a), jnp.asarray(n)) for n in indices] for a in alphas]
            through = [[compute(a, n, jnp.asarray(cosines))[:, 0] for a, n in row] for row in rows]
            inside = [[compute(a, 1.0 / n, jnp.asarray(nodes))[:, 1] for a, n in row] for row in rows]
            tables[f"transmittance {name}"] = np.asarray(through, np.float32)
            mean = (np.asarray(inside) * 2.0 * nodes * weights).sum(-1)
            tables[f"internal reflectance {name}"] = mean.astype(np.float32)
    return tables


if __name__ == "__main__":
    np.savez(FILE, **compute_tables())
