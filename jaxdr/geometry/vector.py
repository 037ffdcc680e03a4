"""Vector algebra, safe to differentiate. Only this file takes coordinates apart and puts them together.

Coordinates are taken apart by `unstack`, whose transpose is one `stack`. The transpose of slices would be one padding
for each slice. The transpose of a product with numbers repeated along the axis would be a sum over the axis. XLA's CPU
compiler makes slow programs of both. Arithmetic is on numbers [*n], because programs on columns [*n, 1] are slower.
`jax.jit` makes each function one equation, which is traced, differentiated and lowered once per shape.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Shaped


def components(v: Shaped[ArrayLike, "*n d"]) -> tuple[Shaped[Array, "*n"], ...]:
    """The components over the last axis: x, y and z of vectors; red, green and blue of colours."""
    v = jnp.asarray(v)
    return tuple(jax.lax.unstack(v, v.ndim - 1))


def z_of(v: Shaped[ArrayLike, "*n 3"]) -> Shaped[Array, "*n"]:
    """The third component: the cosine to the normal of local directions, the depth of points before a camera."""
    v = jnp.asarray(v)
    return jax.lax.squeeze(jax.lax.split(v, (2, 1), v.ndim - 1)[1], (v.ndim - 1,))


def from_components(*numbers: Shaped[ArrayLike, "*#n"]) -> Shaped[Array, "*n d"]:
    """Vectors with these components."""
    arrays, dtype = jnp.broadcast_arrays(*numbers), jnp.result_type(*numbers)
    return jax.lax.stack([array.astype(dtype) for array in arrays], arrays[0].ndim)


def corners(triangles: Shaped[ArrayLike, "*n k d"]) -> tuple[Shaped[Array, "*n d"], ...]:
    """The k vertices of every row."""
    triangles = jnp.asarray(triangles)
    return tuple(jax.lax.unstack(triangles, triangles.ndim - 2))


@jax.jit
def dot(a: Float[ArrayLike, "*#n d"], b: Float[ArrayLike, "*#n d"]) -> Float[Array, "*#n"]:
    """Inner product over the last axis.

    The sum is written out because of an error in XLA's CPU compiler (jaxlib 0.10.2): rows from 32768 on are wrong if it
    fuses a sum over the axis with a product by one vector for all rows, as in the derivative by a camera's position.
    """
    first, *others = components(jnp.multiply(a, b))
    return sum(others, start=first)


@jax.jit
def cross(a: Float[ArrayLike, "*#n 3"], b: Float[ArrayLike, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Vector product."""
    (ax, ay, az), (bx, by, bz) = components(a), components(b)
    return from_components(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


@jax.jit
def scale(v: Float[ArrayLike, "*#n d"], s: Float[ArrayLike, "*#n"]) -> Float[Array, "*#n d"]:
    """Vectors or colours times numbers, row by row."""
    v, s = jnp.asarray(v), jnp.asarray(s)
    if s.ndim == 0:
        return v * s
    return from_components(*(part * s for part in components(v)))


@jax.jit
def norm(a: Float[ArrayLike, "*n d"]) -> Float[Array, "*n"]:
    """Length over the last axis; zero vectors give length zero and derivative zero (see `vanishes`)."""
    squared = dot(a, a)
    positive = _positive(squared)
    return jax.lax.select(positive, jnp.sqrt(_or_one(positive, squared)), jnp.zeros_like(squared))


@jax.jit
def normalize(a: Float[ArrayLike, "*n d"]) -> Float[Array, "*n d"]:
    """Unit vectors; zero vectors (see `vanishes`) become zero with derivative zero."""
    squared = dot(a, a)
    positive = _positive(squared)
    # Divide, and don't multiply by the inverse. A product and a sum after it, as in 1 + z, become one fused operation
    # in some copies that the compiler makes, and two operations in others. The results differ if the sum cancels. Zero
    # vectors are divided by infinity.
    length = jax.lax.select(positive, jnp.sqrt(_or_one(positive, squared)), jnp.full_like(squared, jnp.inf))
    return from_components(*(part / length for part in components(a)))


@jax.jit
def vanishes(a: Float[ArrayLike, "*n d"]) -> Bool[Array, "*n"]:
    """Whether `norm` and `normalize` take vectors for zero: if the squared length is no normal number.

    In float32 these are lengths below 1e-19. Square roots take smaller numbers for zero on some devices (GPUs, and CPUs
    within XLA) and not on others.
    """
    return ~_positive(dot(a, a))


def _positive(squared: Float[Array, "*n"]) -> Bool[Array, "*n"]:
    return squared >= jnp.finfo(squared.dtype).tiny


def _or_one(condition: Bool[Array, "*n"], value: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return jax.lax.select(condition, value, jnp.ones_like(value))


@jax.jit
def interpolate(
    values: Float[ArrayLike, "*#n 3 d"] | tuple[Array, ...], barycentric: Float[ArrayLike, "*#n 3"]
) -> Float[Array, "*#n d"]:
    """Values inside faces, interpolated from those at their three corners, which may be given as a tuple."""
    parts = values if isinstance(values, tuple) else corners(values)
    weights = components(barycentric)
    a, b, c = ([x * weight for x in components(part)] for part, weight in zip(parts, weights, strict=True))
    return from_components(*(x + y + z for x, y, z in zip(a, b, c, strict=True)))


@jax.jit
def between(a: Float[ArrayLike, "*#n d"], b: Float[ArrayLike, "*#n d"], share: Float[ArrayLike, "*#n"]):
    """Points at the fractions `share` from `a` to `b`, [*n, d]."""
    rest = jnp.subtract(1, share)
    return from_components(*(rest * x + share * y for x, y in zip(components(a), components(b), strict=True)))


@jax.jit
def triangle_normals(triangles: Float[ArrayLike, "*n 3 3"]) -> Float[Array, "*n 3"]:
    """Vector products of two sides: normals whose length is twice the area."""
    a, b, c = corners(triangles)
    return cross(b - a, c - a)


@jax.jit
def transform(matrix: Float[ArrayLike, "*#n m 3"], v: Float[ArrayLike, "*#n 3"]) -> Float[Array, "*#n m"]:
    """matrix @ v for every row."""
    matrix, (x, y, z) = jnp.asarray(matrix), components(v)
    entries = components(matrix.reshape(*matrix.shape[:-2], -1))
    return from_components(
        *(entries[k] * x + entries[k + 1] * y + entries[k + 2] * z for k in range(0, len(entries), 3))
    )


@jax.jit
def orthonormal_basis(n: Float[ArrayLike, "*n 3"]) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"]]:
    """Two tangents that complete unit `n` to a right-handed frame (Duff et al. 2017, branchless)."""
    x, y, z = components(n)
    one = jnp.ones_like(z)
    sign = jax.lax.select(z >= 0, one, -one)
    a = -1.0 / (sign + z)
    b = x * y * a
    s = from_components(1.0 + sign * x * x * a, sign * b, -sign * x)
    t = from_components(b, sign + y * y * a, -y)
    return s, t


class Frame(NamedTuple):
    """Orthonormal axes in the world."""

    x: Float[ArrayLike, "*#n 3"]
    y: Float[ArrayLike, "*#n 3"]
    z: Float[ArrayLike, "*#n 3"]

    def to_local(self, v: Float[ArrayLike, "*#n 3"]) -> Float[Array, "*#n 3"]:
        """World vectors in the frame."""
        return _to_local(self, v)

    def to_world(self, v: Float[ArrayLike, "*#n 3"]) -> Float[Array, "*#n 3"]:
        """Vectors of the frame in the world."""
        return _to_world(self, v)


@jax.jit
def _to_local(frame: Frame, v):
    return from_components(*(dot(v, axis) for axis in frame))


@jax.jit
def _to_world(frame: Frame, v):
    parts = zip(components(v), (components(axis) for axis in frame), strict=True)
    a, b, c = ([number * part for part in axis] for number, axis in parts)
    return from_components(*(x + y + z for x, y, z in zip(a, b, c, strict=True)))
