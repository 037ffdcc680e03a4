"""Laplacian preconditioning of vertex positions."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_array
from jaxdr.geometry.mesh import Mesh


@checked
class LargeSteps(eqx.Module):
    """Latent coordinates u = (I + lam L) v of a mesh. Steps in u move the vertices v smoothly.

    Nicolet, Jacobson and Jakob 2021, "Large Steps in Inverse Rendering of Geometry", with the combinatorial Laplacian L
    = D - A. A step down dE/du moves v by (I + lam L)^-2 dE/dv, a smoothed gradient.

    `lam` is the strength of the smoothing: 0 does nothing, 19 is a good start for remeshed objects. The matrix is
    factorised once, on the host in float64, for the edges of `mesh`. A mesh with new faces needs a new `LargeSteps`.
    The object is a pytree: close over it in a jitted function, or pass it as an argument. A pickle of it has the edges,
    and factorises again when it is read.

    Raises ValueError when `lam` is negative or not finite.
    """

    edges: Int[Array, "E 2"]
    degrees: Int[Array, " V"]
    lam: float = eqx.field(static=True)
    factors: "Factors" = eqx.field(static=True)

    def __init__(self, mesh: Mesh, lam: float = 19.0):
        if not (np.isfinite(lam) and lam >= 0):
            raise ValueError(f"LargeSteps: lam must be a finite number, zero or larger; got {lam}")
        edges, count = np.asarray(mesh.edges.vertices), len(mesh.vertices)
        degrees = np.bincount(edges.ravel(), minlength=count)
        self.edges = as_array(edges, np.int32)
        self.degrees = as_array(degrees, np.int32)
        self.lam = float(lam)
        self.factors = Factors(edges, degrees, self.lam)

    def to_latent(self, vertices: Float[Array, "V n"]) -> Float[Array, "V n"]:
        """u = (I + lam L) v, column by column. Raises ValueError for another number of vertices than the mesh's."""
        self._check(vertices, "vertices")
        return self._multiply(vertices)

    def from_latent(self, latent: Float[Array, "V n"]) -> Float[Array, "V n"]:
        """v = (I + lam L)^-1 u, by the factors made at construction.

        Works under jit, vmap and both modes of differentiation. The solve runs on the host in float64; the
        result has the dtype of `latent`. Raises ValueError for another number of vertices than the mesh's.
        """
        self._check(latent, "latent")
        return jax.lax.custom_linear_solve(self._multiply, latent, lambda _, b: self.factors(b), symmetric=True)

    def _multiply(self, x: Float[Array, "V n"]) -> Float[Array, "V n"]:
        a, b = self.edges[:, 0], self.edges[:, 1]
        neighbours = jnp.zeros_like(x).at[a].add(x[b]).at[b].add(x[a])
        return x + self.lam * (self.degrees[:, None] * x - neighbours)

    def _check(self, x, name: str):
        if jnp.ndim(x) != 2 or x.shape[0] != len(self.degrees):
            raise ValueError(f"LargeSteps: {name} must have shape [{len(self.degrees)}, 3], got {jnp.shape(x)}")


class Factors:
    """Sparse LU factors of I + lam L for the undirected `edges` [E, 2] of a graph with vertex `degrees` [V].

    Compared and hashed by identity, so that it can be static in a pytree: a new factorisation traces anew. In a pickle
    are the edges: SuperLU's factors can't be written, and are the same bit for bit when they are made again.
    """

    def __init__(self, edges: np.ndarray, degrees: np.ndarray, lam: float):
        import scipy.sparse  # on use: importing it takes long
        import scipy.sparse.linalg

        self._made_of = edges, degrees, lam
        count = len(degrees)
        weights = np.full(len(edges), -lam)
        upper = scipy.sparse.coo_matrix((weights, (edges[:, 0], edges[:, 1])), (count, count))
        matrix = scipy.sparse.diags(1.0 + lam * degrees) + upper + upper.T
        self._lu = scipy.sparse.linalg.splu(matrix.tocsc())

    def __reduce__(self):
        return Factors, self._made_of

    def __copy__(self) -> "Factors":
        return self  # nothing in it changes, and a copy that is another one would trace anew

    def __deepcopy__(self, memo: dict) -> "Factors":
        return self

    def __call__(self, b: Float[Array, "V n"]) -> Float[Array, "V n"]:
        """Solve for every column of `b`, inside JAX."""
        result = jax.ShapeDtypeStruct(b.shape, b.dtype)
        return jax.pure_callback(partial(_solve, self._lu), result, b, vmap_method="expand_dims")


def _solve(lu, b) -> np.ndarray:
    """Columns of `b` [..., V, n] solved in float64 on the host."""
    b = np.asarray(b)
    columns = np.moveaxis(b.astype(np.float64), -2, 0)  # [V, ..., n]
    solved = lu.solve(columns.reshape(len(columns), -1)).reshape(columns.shape)
    return np.ascontiguousarray(np.moveaxis(solved, 0, -2), dtype=b.dtype)
