"""The unknowns: ranges, latent coordinates, steps of what is known, and how they pass to another mesh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry import shapes
from jaxdr.optimize.preconditioner import LargeSteps
from jaxdr.optimize.reconstruction import stage
from jaxdr.optimize.reconstruction.config import Level, Rates, ReconstructConfig
from jaxdr.optimize.reconstruction.photo_set import PhotoSet
from jaxdr.optimize.reconstruction.unknowns import (
    Unknowns,
    carried,
    from_latent,
    optimizer,
    reflectance,
    roughness_of,
    to_latent,
)

MESH = shapes.sphere(2, radius=0.5).smooth()
COUNT = len(MESH.vertices)


def unknowns() -> Unknowns:
    draw = np.random.default_rng(0).normal
    shapes_of = ((COUNT, 3), (COUNT, 1), (5, 8, 3), (2, 3), (2, 6))
    values = (MESH.vertices, *(draw(size=shape) for shape in shapes_of))
    return Unknowns(*(jnp.asarray(value, float) for value in values))


def test_they_stay_in_their_ranges():
    wild = jnp.asarray([[-1e3], [0.0], [1e3]])
    assert (reflectance(jnp.tile(wild, 3)) >= 0).all() and (reflectance(jnp.tile(wild, 3)) <= 1).all()
    np.testing.assert_allclose(roughness_of(wild), [0.05, 0.525, 1.0], rtol=1e-6)


def test_latent_coordinates_come_back_and_leave_the_rest_alone():
    steps, values = LargeSteps(MESH, 4.0), unknowns()
    latent = to_latent(steps, values)
    back = from_latent(steps, latent)
    for name in Unknowns._fields:
        np.testing.assert_allclose(getattr(back, name), getattr(values, name), atol=2e-5)
    assert latent.albedo is values.albedo and latent.light is values.light


@pytest.mark.parametrize("unknown", [(), ("albedo",), ("roughness", "light", "exposure"), ("cameras",)])
def test_only_vertices_and_what_is_unknown_move(unknown):
    transformation = optimizer(Rates(), unknown, 10, 0)
    values = unknowns()
    gradient = jax.tree.map(jnp.ones_like, values)
    updates, _ = transformation.update(gradient, transformation.init(values), values)
    for name in Unknowns._fields:
        moved = name == "vertices" or name in unknown
        expected = -getattr(Rates(), name) if moved else 0.0
        np.testing.assert_allclose(getattr(updates, name), expected, rtol=1e-3)


def test_rates_fall_to_their_share_over_all_levels():
    late = optimizer(Rates(), ("albedo",), 10, 10)
    values = unknowns()
    updates, _ = late.update(jax.tree.map(jnp.ones_like, values), late.init(values), values)
    np.testing.assert_allclose(updates.vertices, -Rates().vertices * Rates().final, rtol=1e-3)


def test_values_pass_to_another_mesh_of_the_same_surface():
    finer = shapes.sphere(3, radius=0.5)
    (values,) = carried(MESH, finer, np.asarray(MESH.vertices))
    assert np.abs(values - np.asarray(finer.vertices)).max() < 0.1
    (same,) = carried(MESH, MESH, np.asarray(MESH.vertices))
    np.testing.assert_allclose(same, np.asarray(MESH.vertices), atol=1e-4)


def test_a_mesh_that_cannot_be_remeshed_stays_and_says_why(monkeypatch):
    def refuse(mesh, vertices):
        raise ValueError("folded")

    monkeypatch.setattr(stage, "remesh_to", refuse)
    level = Level(steps=1, resolution=16, vertices=60, sky=9)
    config = ReconstructConfig("photos", "out", levels=(level,))
    mesh, values, problem = stage.next_unknowns(config, object.__new__(PhotoSet), 0, MESH, unknowns())
    assert mesh is MESH and problem == "folded"
    assert values.light.shape == (9, 16, 3) and (values.albedo == unknowns().albedo).all()
