"""LargeSteps: the linear system, its derivatives and its use under JAX transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.preconditioner import LargeSteps

# Octahedron with one vertex out of place: closed, 6 vertices, 12 edges.
VERTICES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1.5, 0], [0, 0.2, 1], [0, 0, -1]])
FACES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])


def dense_matrix(lam):
    matrix = np.eye(6)
    for face in FACES:
        for a, b in ((0, 1), (1, 2), (2, 0)):
            i, j = face[a], face[b]
            # Every edge is seen from its two faces: half of its weight from each.
            matrix[i, i] += lam / 2
            matrix[j, j] += lam / 2
            matrix[i, j] -= lam / 2
            matrix[j, i] -= lam / 2
    return matrix


@pytest.fixture(scope="module")
def mesh():
    return Mesh(VERTICES, FACES)


@pytest.mark.parametrize("lam", [0.0, 3.5, 50.0])
def test_to_latent_is_the_dense_product(mesh, lam):
    np.testing.assert_allclose(LargeSteps(mesh, lam).to_latent(mesh.vertices), dense_matrix(lam) @ VERTICES, rtol=2e-6)


def test_from_latent_inverts_to_latent(mesh):
    steps = LargeSteps(mesh, 19.0)
    back = steps.from_latent(steps.to_latent(mesh.vertices))
    np.testing.assert_allclose(back, VERTICES, atol=5e-6)


@pytest.mark.parametrize("columns", [1, 4])
def test_any_number_of_columns_is_solved_one_by_one(mesh, columns):
    steps = LargeSteps(mesh, 3.0)
    values = jnp.asarray(np.random.default_rng(1).normal(size=(6, columns)), jnp.float32)
    np.testing.assert_allclose(steps.to_latent(values), dense_matrix(3.0) @ values, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(steps.from_latent(steps.to_latent(values)), values, atol=1e-5)


def test_gradient_in_latent_is_the_preconditioned_gradient(mesh):
    steps = LargeSteps(mesh, 7.0)
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(6, 3)), jnp.float32)
    gradient = jax.jit(jax.grad(lambda u: (weights * steps.from_latent(u)).sum()))(steps.to_latent(mesh.vertices))
    np.testing.assert_allclose(gradient, np.linalg.solve(dense_matrix(7.0), weights), atol=1e-6)


def test_modes_of_differentiation_agree(mesh):
    steps = LargeSteps(mesh, 7.0)
    rng = np.random.default_rng(1)
    u, tangent, cotangent = (jnp.asarray(rng.normal(size=(6, 3)), jnp.float32) for _ in range(3))
    _, forward = jax.jvp(steps.from_latent, (u,), (tangent,))
    _, pullback = jax.vjp(steps.from_latent, u)
    np.testing.assert_allclose((forward * cotangent).sum(), (tangent * pullback(cotangent)[0]).sum(), rtol=1e-5)


def test_vmap_solves_each_member(mesh):
    steps = LargeSteps(mesh, 7.0)
    batch = jnp.asarray(np.random.default_rng(2).normal(size=(2, 4, 6, 3)), jnp.float32)
    together = jax.jit(jax.vmap(jax.vmap(steps.from_latent)))(batch)
    expected = np.linalg.solve(dense_matrix(7.0), np.asarray(batch))
    np.testing.assert_allclose(together, expected, atol=1e-6)


def test_is_an_argument_as_well_as_a_constant(mesh):
    weak, strong = LargeSteps(mesh, 1.0), LargeSteps(mesh, 30.0)
    solve = jax.jit(lambda steps, u: steps.from_latent(u))
    u = jnp.asarray(VERTICES, jnp.float32)
    for steps in (weak, strong, weak):
        np.testing.assert_allclose(solve(steps, u), steps.from_latent(u), rtol=1e-6)
    assert not np.allclose(solve(weak, u), solve(strong, u))


def test_float64_is_honoured():
    with jax.enable_x64(True):
        mesh = Mesh(VERTICES, FACES)
        steps = LargeSteps(mesh, 50.0)
        latent = steps.to_latent(mesh.vertices)
        assert latent.dtype == jnp.float64
        np.testing.assert_allclose(steps.from_latent(latent), VERTICES, atol=1e-13)


def test_an_unused_vertex_stays_where_it_is():
    mesh = Mesh(np.vstack([VERTICES, [[5.0, 6.0, 7.0]]]), FACES)
    steps = LargeSteps(mesh, 19.0)
    np.testing.assert_allclose(steps.from_latent(mesh.vertices)[6], [5, 6, 7], rtol=1e-6)


@pytest.mark.parametrize("lam", [-1.0, float("nan"), float("inf")])
def test_rejects_bad_lam(mesh, lam):
    with pytest.raises(ValueError, match="lam must be a"):
        LargeSteps(mesh, lam)


def test_rejects_another_number_of_vertices(mesh):
    with pytest.raises(ValueError, match=r"latent must have shape \[6, 3\], got \(5, 3\)"):
        LargeSteps(mesh, 1.0).from_latent(jnp.zeros((5, 3)))
