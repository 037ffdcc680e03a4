"""Small vector algebra, safe to differentiate."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def dot(a: Float[Array, "*#n d"], b: Float[Array, "*#n d"]) -> Float[Array, "*#n"]:
    """Inner product over the last axis.

    Written out: XLA's CPU compiler (jaxlib 0.10.2) gets rows from 32768 on wrong where it fuses a sum over an axis of a
    product with one vector for all rows, as in the derivative by a camera's position.
    """
    product = a * b
    return sum((product[..., i] for i in range(1, product.shape[-1])), start=product[..., 0])


def norm(a: Float[Array, "*n d"]) -> Float[Array, "*n"]:
    """Length over the last axis; zero vectors give length zero and derivative zero."""
    squared = dot(a, a)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def normalize(a: Float[Array, "*n d"]) -> Float[Array, "*n d"]:
    """Unit vectors; zero vectors stay zero with derivative zero."""
    squared = dot(a, a)[..., None]
    positive = squared > 0
    return jnp.where(positive, a / jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def interpolate(corners: Float[Array, "*n 3 d"], barycentric: Float[Array, "*n 3"]) -> Float[Array, "*n d"]:
    """Values between those at the corners of faces. Written out: XLA's CPU compiler makes slow sums over short axes."""
    a, b, c = (corners[..., k, :] * barycentric[..., k, None] for k in range(3))
    return a + b + c


def transform(matrix: Float[Array, "3 3"], v: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """matrix @ v for every row; written out for the same reason."""
    x, y, z = (v[..., k, None] * matrix[:, k] for k in range(3))
    return x + y + z


def orthonormal_basis(n: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"]]:
    """Two tangents that complete unit `n` to a right-handed frame (Duff et al. 2017, branchless)."""
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    sign = jnp.where(z >= 0, 1.0, -1.0).astype(n.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    s = jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x], -1)
    t = jnp.stack([b, sign + y * y * a, -y], -1)
    return s, t
