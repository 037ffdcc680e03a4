"""Vector algebra, safe to differentiate: the one place where coordinates are taken apart and put together.

Coordinates are taken apart by `split`, whose transpose is one concatenation. That of a slice is a padding for each, and
that of a product with numbers repeated along the axis a sum over it; XLA's CPU compiler makes slow programs of both.
What it makes of one column [*n, 1] is the same as of [*n]. `jax.jit` makes each function one equation, traced,
differentiated and lowered once per shape.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Shaped


def _columns(v) -> list[Array]:
    """Parts [*n, 1] of [*n, d]."""
    v = jnp.asarray(v)
    return jax.lax.split(v, (1,) * v.shape[-1], v.ndim - 1) if v.shape[-1] > 1 else [v]


def _rows(columns) -> Array:
    """[*n, d] of parts [*n, 1]."""
    return jax.lax.concatenate(columns, columns[0].ndim - 1)


def _number(column):
    return jax.lax.squeeze(column, (column.ndim - 1,))


def components(v: Shaped[ArrayLike, "*n d"]) -> tuple[Shaped[Array, "*n"], ...]:
    """The components over the last axis: x, y and z of vectors, or of colours red, green and blue."""
    return tuple(_number(column) for column in _columns(v))


def from_components(*numbers: Shaped[ArrayLike, "*#n"]) -> Shaped[Array, "*n d"]:
    """Vectors of these components."""
    arrays = jnp.broadcast_arrays(*numbers)
    dtype = jnp.result_type(*numbers)
    arrays = [array.astype(dtype) for array in arrays]
    return _rows([jax.lax.expand_dims(array, (array.ndim,)) for array in arrays])


def corners(triangles: Shaped[ArrayLike, "*n k d"]) -> tuple[Shaped[Array, "*n d"], ...]:
    """The k vertices of every row."""
    triangles = jnp.asarray(triangles)
    axis = triangles.ndim - 2
    parts = jax.lax.split(triangles, (1,) * triangles.shape[axis], axis)
    return tuple(jax.lax.squeeze(part, (axis,)) for part in parts)


@jax.jit
def dot(a: Float[ArrayLike, "*#n d"], b: Float[ArrayLike, "*#n d"]) -> Float[Array, "*#n"]:
    """Inner product over the last axis.

    Written out: XLA's CPU compiler (jaxlib 0.10.2) gets rows from 32768 on wrong where it fuses a sum over an axis of a
    product with one vector for all rows, as in the derivative by a camera's position.
    """
    return _number(_dot(a, b))


def _dot(a, b) -> Array:
    """`dot` as one column [*n, 1]."""
    first, *others = _columns(jnp.multiply(a, b))
    return sum(others, start=first)


@jax.jit
def cross(a: Float[ArrayLike, "*#n 3"], b: Float[ArrayLike, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Vector product."""
    return _rows(_cross(_columns(a), _columns(b)))


def _cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


@jax.jit
def scale(v: Float[ArrayLike, "*#n d"], s: Float[ArrayLike, "*#n"]) -> Float[Array, "*#n d"]:
    """Vectors or colours times numbers, row by row."""
    v, s = jnp.asarray(v), jnp.asarray(s)
    if s.ndim == 0:
        return v * s
    s = jax.lax.expand_dims(s, (s.ndim,))
    return _rows([part * s for part in _columns(v)])


@jax.jit
def norm(a: Float[ArrayLike, "*n d"]) -> Float[Array, "*n"]:
    """Length over the last axis; zero vectors give length zero and derivative zero."""
    squared = dot(a, a)
    positive = squared > 0
    return jax.lax.select(positive, jnp.sqrt(_or_one(positive, squared)), jnp.zeros_like(squared))


@jax.jit
def normalize(a: Float[ArrayLike, "*n d"]) -> Float[Array, "*n d"]:
    """Unit vectors; zero vectors stay zero with derivative zero."""
    squared = _dot(a, a)
    positive = squared > 0
    inverse = jax.lax.select(positive, 1.0 / jnp.sqrt(_or_one(positive, squared)), jnp.zeros_like(squared))
    return _rows([part * inverse for part in _columns(a)])


def _or_one(condition: Bool[Array, "*n"], value: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return jax.lax.select(condition, value, jnp.ones_like(value))


@jax.jit
def interpolate(values: Float[ArrayLike, "*#n 3 d"], barycentric: Float[ArrayLike, "*#n 3"]) -> Float[Array, "*#n d"]:
    """Values between those at the corners of faces."""
    values, weights = jnp.asarray(values), _columns(barycentric)
    width = values.shape[-1]
    parts = _columns(values.reshape(*values.shape[:-2], 3 * width))
    a, b, c = ([part * weight for part in parts[k * width : (k + 1) * width]] for k, weight in enumerate(weights))
    return _rows([x + y + z for x, y, z in zip(a, b, c, strict=True)])


@jax.jit
def transform(matrix: Float[ArrayLike, "*#n m 3"], v: Float[ArrayLike, "*#n 3"]) -> Float[Array, "*#n m"]:
    """matrix @ v for every row."""
    matrix, (x, y, z) = jnp.asarray(matrix), _columns(v)
    entries = _columns(matrix.reshape(*matrix.shape[:-2], -1))
    return _rows([entries[k] * x + entries[k + 1] * y + entries[k + 2] * z for k in range(0, len(entries), 3)])


@jax.jit
def orthonormal_basis(n: Float[ArrayLike, "*n 3"]) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"]]:
    """Two tangents that complete unit `n` to a right-handed frame (Duff et al. 2017, branchless)."""
    x, y, z = _columns(n)
    one = jnp.ones_like(z)
    sign = jax.lax.select(z >= 0, one, -one)
    a = -1.0 / (sign + z)
    b = x * y * a
    s = _rows([1.0 + sign * x * x * a, sign * b, -sign * x])
    t = _rows([b, sign + y * y * a, -y])
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
    return _rows([_dot(v, axis) for axis in frame])


@jax.jit
def _to_world(frame: Frame, v):
    parts = zip(_columns(v), (_columns(axis) for axis in frame), strict=True)
    a, b, c = ([number * part for part in axis] for number, axis in parts)
    return _rows([x + y + z for x, y, z in zip(a, b, c, strict=True)])
