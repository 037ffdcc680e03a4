"""Points on edges by their angle: integrals over the parts of edges that lie in cones, against midpoint sums."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.boundary.shared.edge_angles import Cone, on_edges

COUNT, NUMBERS, POINTS = 1000, 400, 10_000


def cases():
    """Edges from a hundredth to three units, seen from the origin; cones, half of them around the edges' middles."""
    rng = np.random.default_rng(0)
    size = np.geomspace(0.01, 3.0, COUNT)[:, None, None]
    ends = (rng.standard_normal((COUNT, 2, 3)) * size + 2 * rng.standard_normal((COUNT, 1, 3))).astype(np.float32)
    direction = np.where(np.arange(COUNT)[:, None] % 2 == 0, ends.mean(1), rng.standard_normal((COUNT, 3)))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    cosine = np.cos(rng.uniform(0.01, 1.5, COUNT))
    cosine[::5] = -1.0
    return ends, Cone(jnp.asarray(direction, jnp.float32), jnp.asarray(cosine, jnp.float32))


def weight(along):
    """Something that changes along an edge."""
    return np.sin(3 * along) + 2


def test_points_have_the_density_that_the_angle_says():
    """∫ weight da over the part in the cone, and no point lies outside of it."""
    ends, cone = cases()
    draw = jax.jit(lambda u: on_edges(jnp.asarray(ends), jnp.zeros((COUNT, 3)), jnp.full(COUNT, u), cone))
    start, side = ends[:, 0].astype(float), (ends[:, 1] - ends[:, 0]).astype(float)
    direction, cosine = (np.asarray(a, float) for a in cone)
    found = np.zeros(COUNT)
    for k in range(NUMBERS):
        along, angle = map(np.asarray, draw((k + 0.5) / NUMBERS))
        found += angle * weight(along) / NUMBERS
        point = start + along[:, None] * side
        point /= np.linalg.norm(point, axis=1, keepdims=True)
        assert np.all((point * direction).sum(1)[angle > 0] > cosine[angle > 0] - 1e-6)
    exact, whole = np.zeros(COUNT), np.zeros(COUNT)
    along = (np.arange(POINTS) + 0.5) / POINTS
    for i in range(COUNT):
        points = start[i] + along[:, None] * side[i]
        distance = np.linalg.norm(points, axis=1)
        value = np.linalg.norm(np.cross(points, side[i]), axis=1) / distance**2 * weight(along)
        exact[i], whole[i] = (value * (points @ direction[i] >= cosine[i] * distance)).mean(), value.mean()
    assert 0.1 < np.mean(exact == 0) < 0.6 and np.mean((exact > 0) & (exact < 0.99 * whole)) > 0.05
    assert np.all(np.abs(found - exact) < 1e-7 + 2e-3 * whole)
