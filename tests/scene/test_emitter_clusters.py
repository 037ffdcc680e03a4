"""Clusters of emitting faces: exact densities, cuts that hold every face once, nothing where emitters are few."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import box, plane, sphere
from jaxdr.geometry.vector import dot
from jaxdr.scene.packed import pack
from jaxdr.transport.emission import emitting_surface_pdf, sample_emitting_surface
from jaxdr.transport.interaction import material_point

CAMERA = jd.Perspective(jd.look_at([0, -5, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(4, 4))
LAMPS = {
    "flat": plane(1.0, 3, (0.0, 0.0, 3.0)),
    "round": sphere(2, radius=0.3, center=(0.0, 0.0, 3.0)),
}
OTHER = box((0.2, 0.2, 0.2), (2.0, 0.0, 1.0))
APEXES = jnp.asarray([[1.0, 2.0, 0.0], [0.0, 0.0, 2.9], [0.0, 0.0, 3.25], [0.2, 0.0, 5.0]])  # far, inside, close, above


def glowing(mesh, radiance):
    return jd.Shape(mesh, jd.Diffuse(0.0), jd.AreaEmitter(radiance))


@jax.jit
def looked_at(packed, apex, u):
    """(densities of all emitting faces at one apex, drawn faces, their densities, nodes of the faces, the cut)."""
    faces, apexes = packed.emitter_faces, jnp.broadcast_to(apex, (u.shape[0], 3))
    point, density = sample_emitting_surface(packed, u, apexes)
    again = emitting_surface_pdf(packed, point, apexes)
    everywhere = jnp.broadcast_to(apex, (faces.shape[0], 3))
    cut = packed.clusters.cut(everywhere)
    nodes = packed.clusters.node_at(cut, faces)
    middle = material_point(packed, faces, jnp.full((faces.shape[0], 3), 1 / 3), jnp.ones(faces.shape, bool))
    shines = dot(everywhere - middle.position, middle.normal) > 1e-6
    first = jax.tree.map(lambda table: table[0], cut)
    return packed.clusters.pdf(everywhere, faces), point.face, (density, again), nodes, first, shines


@pytest.mark.parametrize("lamp", LAMPS)
def test_densities_are_exact_and_cuts_whole(lamp):
    scene = jd.Scene({"box": jd.Shape(box()), "lamp": glowing(LAMPS[lamp], 5.0), "other": glowing(OTHER, 0.3)}, CAMERA)
    packed, count = jax.jit(pack)(scene), 100_000
    clusters, faces = jax.device_get(packed.clusters), np.asarray(packed.emitter_faces)
    corners = np.asarray(packed.vertices)[np.asarray(packed.faces)[faces]]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    power = np.asarray(packed.emitter_density)[faces] * area
    u = jax.random.uniform(jax.random.key(0), (count, 2))
    for apex in APEXES:
        pdf, drawn, densities, node, cut, shines = jax.device_get(looked_at(packed, apex, u))
        # What is drawn, and with which density: exactly, and nothing that can shine here is left out.
        np.testing.assert_allclose(*densities, rtol=1e-5)
        np.testing.assert_allclose((pdf * area).sum(), 1.0, rtol=1e-5)
        assert (pdf[shines] > 0).all()
        found, expected = np.bincount(drawn, minlength=packed.faces.shape[0]), pdf * area * count
        assert found[faces].sum() == count
        found, there = found[faces], expected > 0
        assert not found[~there].any()
        chi2, free = ((found - expected)[there] ** 2 / expected[there]).sum(), there.sum()
        assert chi2 < free + 5 * np.sqrt(2 * free)
        # Every face is in one cluster of the cut, within its sphere.
        np.testing.assert_allclose(cut.probability.sum(), 1.0, rtol=1e-5)
        assert not cut.probability[~cut.used].any() and cut.used[node].all()
        used = np.nonzero(cut.used)[0]
        np.testing.assert_allclose(np.bincount(node, power, 64)[used], clusters.power[used], atol=1e-5)
        away = np.linalg.norm(corners - clusters.centre[node][:, None], axis=-1).max(1)
        assert (away <= clusters.radius[node]).all()


def test_few_faces_have_none():
    def clusters(lamp):
        return jax.eval_shape(lambda: pack(jd.Scene({"lamp": glowing(lamp, 1.0)}, CAMERA))).clusters

    assert clusters(box()) is None and clusters(plane(1.0, 2)) is None and clusters(plane(1.0, 3)) is not None


def test_lamps_that_are_off_are_chosen_by_area():
    """As an optimisation of their radiance may start."""

    @jax.jit
    def density():
        packed = pack(jd.Scene({"lamp": glowing(LAMPS["flat"], 0.0)}, CAMERA))
        return packed.clusters.pdf(jnp.broadcast_to(jnp.asarray([0.0, 0.0, 9.0]), (18, 3)), packed.emitter_faces)

    np.testing.assert_allclose(density(), 1.0, rtol=0.01)
