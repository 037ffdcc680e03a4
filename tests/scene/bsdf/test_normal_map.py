"""Normal maps: frames, sides, what they need of a mesh; textured masks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.packed import pack
from jaxdr.scene.sampling import LEAST
from jaxdr.transport.interaction import material_point
from jaxdr.transport.shading import Scatterer
from tests.scene.bsdf.checks import call, random_directions, uniform

COLOUR = (0.2, 0.5, 0.8)
CAMERA = jd.Perspective(jd.look_at((0, 0, 4), (0, 0, 0), (0, 1, 0)), 40.0, jd.Film(2, 2))
UP = np.array([[0.0, 0.0, 1.0]])


def stored(normal):
    """As a texture stores it."""
    return 0.5 * (np.asarray(normal) / np.linalg.norm(normal) + 1)


def test_a_flat_map_changes_nothing():
    inner = jd.Principled(COLOUR, 0.3, 0.4)
    flat, wi, wo = jd.NormalMap((0.5, 0.5, 1.0), inner), random_directions(50, 0), random_directions(50, 1)
    for method, arrays in (("eval", (wi, wo)), ("pdf", (wi, wo)), ("sample", (wi, uniform(50, 2)))):
        np.testing.assert_allclose(call(flat, method, *arrays), call(inner, method, *arrays), rtol=1e-5, atol=1e-6)


def test_diffuse_in_closed_form():
    """Albedo / pi times the cosine to the mapped normal, shadowed by Estevez et al. 2019, where both sides agree."""
    normal = np.array([0.48, -0.36, 0.8])
    wi, wo = np.asarray(random_directions(200, 3, 0.3)), np.asarray(random_directions(200, 4))
    away = wi @ normal <= 0
    assert 2 < away.sum() < 100
    turned = np.where(away[:, None], normal * [-1, -1, 1], normal)
    cosine = (wo * turned).sum(1)
    alpha2 = min(0.125 * (1 / 0.8**2 - 1), 1.0)
    shadow = 2 / (1 + np.sqrt(1 + alpha2 * (1 / wo[:, 2] ** 2 - 1)))
    expected = np.where((cosine > 0) & (wo[:, 2] > 0), cosine / np.pi * shadow, 0.0)
    found = call(jd.NormalMap(stored(normal), jd.Diffuse(COLOUR)), "eval", wi, wo)
    np.testing.assert_allclose(found, expected[:, None] * COLOUR, rtol=1e-4, atol=1e-6)


def test_mirrors_tilt():
    """A mirror tilted by 20 degrees reflects the normal by 40, to the side it leans to; past the horizon nothing."""
    tilt = np.deg2rad(20)
    mirror = jd.NormalMap(stored((np.sin(tilt), 0, np.cos(tilt))), jd.Conductor())
    assert mirror.delta
    sample = call(mirror, "sample_delta", UP, uniform(1, 0))
    np.testing.assert_allclose(sample.wo[0], [np.sin(2 * tilt), 0, np.cos(2 * tilt)], atol=1e-5)
    assert sample.weight[0, 0] > 0.9 and sample.probability[0] == 1
    grazing = np.array([[-np.sin(1.0), 0.0, np.cos(1.0)]])  # its mirror image would be at 97 degrees
    assert np.all(call(mirror, "sample_delta", grazing, uniform(1, 0)).weight == 0)


def scatter(bsdf, wo, wi=(0.0, 0.0, 1.0), uvs=((0, 0), (1, 0), (1, 1), (0, 1)), texture_faces=((0, 1, 2), (0, 2, 3))):
    """eval of a BSDF on a square in the plane z = 0 facing +z, in world space."""
    mesh = jd.Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], uvs, texture_faces)
    plain = jd.Shape(jd.shapes.rectangle(), jd.Diffuse(0.9))
    packed = pack(jd.Scene({"mapped": jd.Shape(mesh, bsdf), "other": plain}, CAMERA))
    point = material_point(packed, jnp.zeros(1, jnp.int32), jnp.full((1, 3), 1 / 3), jnp.ones(1, bool))
    return Scatterer(packed, point, jnp.asarray([wi], float)).eval(jnp.asarray([wo], float))[0, 0]


TO_U = jd.NormalMap(jd.Bitmap(np.full((2, 2, 3), stored((0.5, 0, 0.8)))), jd.Diffuse())
TO_V = jd.NormalMap(jd.Bitmap(np.full((2, 2, 3), stored((0, 0.5, 0.8)))), jd.Diffuse())
RIGHT, LEFT, AWAY, NEAR = (0.6, 0, 0.8), (-0.6, 0, 0.8), (0, 0.6, 0.8), (0, -0.6, 0.8)


def test_bumps_lean_to_increasing_u_and_v():
    """Red is along u, green along v from an image's bottom to its top, wherever the UVs put that."""
    assert scatter(TO_U, RIGHT) > 1.4 * scatter(TO_U, AWAY) > 2 * scatter(TO_U, LEFT)
    assert scatter(TO_V, AWAY) > 1.4 * scatter(TO_V, RIGHT) > 2 * scatter(TO_V, NEAR)
    quarter = {"uvs": ((0, 1), (0, 0), (1, 0), (1, 1))}  # the image is turned: u along y, v along -x
    np.testing.assert_allclose(scatter(TO_U, AWAY, **quarter), scatter(TO_U, RIGHT), rtol=1e-5)
    np.testing.assert_allclose(scatter(TO_V, LEFT, **quarter), scatter(TO_V, AWAY), rtol=1e-5)
    nowhere = {"uvs": ((0.5, 0.5),), "texture_faces": ((0, 0, 0), (0, 0, 0))}  # UVs that tell no direction
    assert scatter(TO_U, RIGHT, **nowhere) > 0


def test_two_sided_maps():
    """Seen from behind the frame is mirrored: bumps lean to the same side."""
    both = jd.TwoSided(TO_U)
    for lean in (RIGHT, LEFT):
        behind = scatter(both, np.multiply(lean, (1, 1, -1)), wi=(0.0, 0.0, -1.0))
        np.testing.assert_allclose(behind, scatter(TO_U, lean), rtol=1e-5)
    assert scatter(TO_U, (0.6, 0, -0.8), wi=(0.0, 0.0, -1.0)) == 0


def test_what_is_refused():
    with pytest.raises(
        ValueError, match=r"NormalMap: bsdf can't be a TwoSided; .* TwoSided\(NormalMap\(normal, bsdf\)\)"
    ):
        jd.NormalMap(0.5, jd.TwoSided(jd.Diffuse()))
    with pytest.raises(ValueError, match=r"NormalMap: normal must be in \[0, 1\]"):
        jd.NormalMap((0.0, 0.0, -1.0), jd.Diffuse())
    bare = jd.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for bsdf in (jd.NormalMap((0.5, 0.6, 0.9), jd.Diffuse()), jd.Mask(0.5, TO_U)):
        with pytest.raises(ValueError, match=r"Scene: bare\.bsdf.* 'bare' has no"):
            jd.Scene({"bare": jd.Shape(bare, bsdf)}, CAMERA)


def test_a_textured_mask():
    """The model of every point has its opacity; a scene with it loads, but is not rendered yet."""
    opacity = jnp.asarray([0.0, 0.25, 1.0])
    mask = jd.Mask(jd.Bitmap(np.array([[0.0, 0.25, 1.0]])), jd.Diffuse(COLOUR))
    at_points = jax.tree.map(lambda x: jnp.broadcast_to(x, (3, *x.shape)), mask.bsdf)
    resolved = jax.tree.unflatten(jax.tree.structure(jd.Mask(0.5, mask.bsdf)), [opacity, *jax.tree.leaves(at_points)])
    wi, wo = random_directions(3, 5, 0.2), random_directions(3, 6, 0.2)
    np.testing.assert_allclose(resolved.eval(wi, wo), opacity[:, None] * mask.bsdf.eval(wi, wo), rtol=1e-5)
    share = jnp.clip(opacity, LEAST, 1.0 - LEAST)
    np.testing.assert_allclose(resolved.pdf(wi, wo), share * mask.bsdf.pdf(wi, wo), rtol=1e-5)
