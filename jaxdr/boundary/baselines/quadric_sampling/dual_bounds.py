"""Bounds of planes in dual space: they tell whether all faces of a part of a mesh face a point, or none does.

A plane n . (x - a) = 0 is the dual point q = (n, -n . a), and a point x is X = (x, 1). Then q . X is the height of x
over the plane. An edge between two faces is a silhouette from x if the heights over both have different signs:
(q0 . X) (q1 . X) <= 0, a quadric in x. A set of faces has no silhouette from x if all its heights have the same sign.
Two bounds of the set of dual points bound the heights (Soroka et al. 2025 name both; the formulas here are our own):

- a box in dual space: the least and the largest q . X of its corners;
- an ellipsoid around the dual points, with centre m and matrix C: m . X -+ sqrt(X' C X). All heights have one sign
  where X' (m m' - C) X > 0. This is a quadric again. For two faces it is the quadric of their edge.

Planes are relative to a centre and in units of a size, those of the node. So float32 bounds the planes of a small patch
as tightly as those of a large one.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import dot

REGULAR = 1e-4  # added to the principal variances, relative to their sum: flat patches have singular matrices
WIDER = 1.01  # ellipsoids are a little larger than computed, because the arithmetic rounds
UPPER = [(i, j) for i in range(4) for j in range(i, 4)]  # the entries of a symmetric matrix that are kept


class DualBounds(NamedTuple):
    """Bounds of the dual points of n sets of planes, in each set's own frame.

    `lower`, `upper`: the box. `mean`, `matrix`: centre and matrix of the ellipsoid; the matrix has the entries `UPPER`.
    """

    lower: Float[Array, "*n 4"]
    upper: Float[Array, "*n 4"]
    mean: Float[Array, "*n 4"]
    matrix: Float[Array, "*n 10"]


def dual_points(
    normal: Float[Array, "*#n 3"],
    point: Float[Array, "*#n 3"],
    centre: Float[Array, "*#n 3"],
    size: Float[Array, "*#n"],
) -> Float[Array, "*n 4"]:
    """Planes through points, with unit normals, in the frame of `centre` and `size`."""
    offset = -dot(normal, point - centre) / size
    return jnp.concatenate([normal, offset[..., None]], -1)


def bound(planes: Float[Array, "n k 4"], counts: Bool[Array, "n k"], exact: bool) -> DualBounds:
    """Bounds of the planes in each row that count; zeros in rows without any.

    `exact`: rows have two planes, and the ellipsoid is the line between them. Then its test is exact.
    """
    mask = counts[..., None]
    some = counts.any(1)[:, None]
    number = jnp.maximum(counts.sum(1), 1)[:, None]
    lower = jnp.where(some, jnp.where(mask, planes, jnp.inf).min(1), 0.0)
    upper = jnp.where(some, jnp.where(mask, planes, -jnp.inf).max(1), 0.0)
    mean = jnp.where(mask, planes, 0.0).sum(1) / number
    apart = jnp.where(mask, planes - mean[:, None], 0.0)
    matrix = jnp.einsum("nki,nkj->nij", apart, apart) / number[..., None]
    if not exact:
        trace = jnp.trace(matrix, axis1=1, axis2=2)
        trace = jnp.where(trace > 0, trace, 1e-12)  # one plane, or several times the same: the mean is its bound
        regular = REGULAR * trace
        matrix = matrix + regular[:, None, None] * jnp.eye(4, dtype=planes.dtype)
        matrix = matrix * (WIDER * _farthest2(matrix, apart, 0.5 * regular))[:, None, None]
    return DualBounds(lower, upper, mean, jnp.stack([matrix[:, i, j] for i, j in UPPER], -1))


def _farthest2(matrix, apart, least):
    """The largest squared Mahalanobis distance v' M^-1 v of vectors [n, k, 4], for matrices [n, 4, 4].

    `least`: a lower bound of the squared diagonal of the factors [n].

    By Cholesky factors, written out: a call of LAPACK for every node would take most of the time.
    """
    factor = [[matrix[:, i, j] for j in range(4)] for i in range(4)]
    for i in range(4):
        for j in range(i + 1):
            for k in range(j):
                factor[i][j] = factor[i][j] - factor[i][k] * factor[j][k]
            if i > j:
                factor[i][j] = factor[i][j] / factor[j][j]
        # Rounding may leave a little less than the regular part, or nothing.
        factor[i][i] = jnp.sqrt(jnp.maximum(factor[i][i], least))
    solved = []
    for i in range(4):
        rest = apart[..., i]
        for k in range(i):
            rest = rest - factor[i][k][:, None] * solved[k]
        solved.append(rest / factor[i][i][:, None])
    return jnp.square(jnp.stack(solved)).sum(0).max(1)


def one_sided(bounds: DualBounds, offset: Float[Array, "*n 3"], slack: Float[Array, "*n"]) -> Bool[Array, "*n"]:
    """Whether all planes have the point at `offset` (in the frame of the planes) on the same side.

    `slack`: an angle by which rounding may have turned the planes.
    """
    point = jnp.concatenate([offset, jnp.ones_like(offset[..., :1])], -1)
    one, two = bounds.lower * point, bounds.upper * point
    middle = (bounds.mean * point).sum(-1)
    square = sum(
        bounds.matrix[..., k] * point[..., i] * point[..., j] * (1.0 if i == j else 2.0)
        for k, (i, j) in enumerate(UPPER)
    )
    half = jnp.sqrt(jnp.maximum(square, 0.0))
    low = jnp.maximum(jnp.minimum(one, two).sum(-1), middle - half)
    high = jnp.minimum(jnp.maximum(one, two).sum(-1), middle + half)
    tolerance = slack * (jnp.abs(offset).sum(-1) + 1.0)
    return (low > tolerance) | (high < -tolerance)
