"""Bump maps: slopes in closed form, beside Mitsuba, continuous, and what they need of a mesh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.texturing import texture_point
from tests.scene.bsdf.checks import random_directions
from tests.scene.bsdf.test_normal_map import CAMERA, stored

COLUMNS, ROWS = np.meshgrid(np.arange(5), np.arange(4))
RAMP = 0.075 * COLUMNS + 0.05 * ROWS  # by columns from the left, by rows from the top
VERTICES = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.4, 1.5, 0.0]])
UVS = np.array([[0.3, 0.3], [0.65, 0.3], [0.4, 0.62]])
METAL = jd.RoughConductor(0.5, alpha_v=0.2)


def points(bump, vertices=VERTICES, count=200):
    """(packed scene, points on one face, their barycentric coordinates)."""
    mesh = jd.Mesh(vertices, [[0, 1, 2]], UVS, [[0, 1, 2]])
    packed, weights = (
        pack(jd.Scene({"a": jd.Shape(mesh, bump)}, CAMERA)),
        np.random.default_rng(0).dirichlet(np.ones(3), count),
    )
    return (
        packed,
        material_point(packed, jnp.zeros(count, jnp.int32), jnp.asarray(weights), jnp.ones(count, bool)),
        weights,
    )


def directions(vertices=VERTICES, count=200):
    """Some to the front, and some to any side."""
    normal = np.cross(vertices[1] - vertices[0], vertices[2] - vertices[0])
    wi, wo = (np.asarray(random_directions(count, seed)) for seed in (0, 1))
    return np.where((wi @ normal)[:, None] < 0, -wi, wi), wo


def test_a_ramp_tilts_the_normal_by_its_slope():
    """On a skew face in space: the gradient of a height that is linear over it, by least squares of its corners."""
    vertices = np.array([[0.0, 0.0, 0.0], [2.0, 0.3, 0.1], [0.4, 1.5, 0.2]])
    to_uv = np.array([[1.1, 0.1, 0.02], [-0.05, 0.9, 0.03]])
    packed, point, _ = points(jd.BumpMap(jd.Bitmap(RAMP, wrap="clamp", to_uv=to_uv), METAL, 1.7), vertices)
    u, v = to_uv @ np.column_stack([UVS, np.ones(3)]).T
    heights = 1.7 * (0.075 * 5 * u + 0.05 * 4 * (1 - v))
    sides = vertices[1:] - vertices[0]
    gradient = np.linalg.pinv(sides) @ (heights[1:] - heights[0])
    wi, wo = directions(vertices)
    scatterer = Scatterer(packed, point, jnp.asarray(wi))
    slope = np.asarray(scatterer.groups[0][0].height) * 1.7
    found = slope[:, :1] * np.asarray(scatterer.frame.x) + slope[:, 1:] * np.asarray(scatterer.frame.y)
    np.testing.assert_allclose(found, np.tile(gradient, (200, 1)), atol=1e-5)
    # The same as a map of that normal.
    normal = np.append(-slope[0], 1.0)
    same = jd.NormalMap(stored(normal), METAL)
    packed, point, _ = points(same, vertices)
    expected = Scatterer(packed, point, jnp.asarray(wi)).eval(jnp.asarray(wo))
    assert (np.asarray(expected) > 0).any(1).sum() > 50
    np.testing.assert_allclose(scatterer.eval(jnp.asarray(wo)), expected, rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("inner", ["metal", "diffuse"])
def test_as_in_mitsuba(inner):
    """A ramp, in whose patches both slopes are the same. (Of skew `to_uv` Mitsuba 3.9 takes another scale.)"""
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    metal = {"type": "roughconductor", "alpha_u": 0.5, "alpha_v": 0.2, "distribution": "ggx"}
    bsdf = {"metal": metal, "diffuse": {"type": "diffuse", "reflectance": 0.8}}[inner]
    image = mi.Bitmap(RAMP[..., None].astype(np.float32))
    texture = {"type": "bitmap", "bitmap": image, "raw": True, "wrap_mode": "clamp", "format": "variant"}
    theirs = mi.load_dict({"type": "bumpmap", "scale": 1.7, "texture": texture, "bsdf": bsdf})
    mesh = mi.Mesh("face", 3, 1, has_vertex_texcoords=True)
    values = mi.traverse(mesh)
    values["vertex_positions"], values["faces"] = VERTICES.ravel(), [0, 1, 2]
    values["vertex_texcoords"] = (UVS * [1, -1] + [0, 1]).ravel()
    values.update()
    packed, point, weights = points(
        jd.BumpMap(jd.Bitmap(RAMP, wrap="clamp"), METAL if inner == "metal" else jd.Diffuse(0.8), 1.7)
    )
    wi, wo = directions()
    expected = []
    for weight, a, b in zip(weights, wi, wo, strict=True):
        ray = mi.Ray3f((weight @ VERTICES + [0, 0, 1]).tolist(), [0, 0, -1])
        si = mesh.ray_intersect_triangle(0, ray).compute_surface_interaction(ray)
        si.wi = si.to_local(mi.Vector3f(a.tolist()))
        expected.append(list(theirs.eval(mi.BSDFContext(), si, si.to_local(mi.Vector3f(b.tolist())))))
    if before is not None:
        mi.set_variant(before)
    found = Scatterer(packed, point, jnp.asarray(wi)).eval(jnp.asarray(wo))
    assert (np.asarray(expected) > 0).any(1).sum() > 50
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_slopes_are_continuous():
    """Across the centres of texels, where those of bilinear patches jump. They are the mean of these over a texel."""
    image = np.random.default_rng(3).uniform(size=(4, 5))
    packed, point, _ = points(jd.BumpMap(jd.Bitmap(image), jd.Diffuse()))
    x = np.linspace(0.05, 0.95, 200)
    line = jnp.asarray(np.column_stack([x, np.full(200, 0.4)]), float)
    at = texture_point(packed, point)._replace(uv=line, axes=jnp.asarray([[1.0, 0.0, 1.0]] * 200))
    texture = jax.tree.map(lambda leaf: leaf[None], jd.scene.textures.Heights(image))
    slopes = np.asarray(texture.lookup(jnp.zeros(200, jnp.int32), at))
    assert np.abs(np.diff(slopes, axis=0)).max() < 0.05 * np.ptp(slopes, axis=0).max()
    heights = np.interp(5 * x[:, None] + [-0.5, 0.5], np.arange(5) + 0.5, 0.9 * image[2] + 0.1 * image[1])
    inside = (x > 0.2) & (x < 0.8)
    np.testing.assert_allclose(slopes[inside, 0], 5 * (heights[:, 1] - heights[:, 0])[inside], rtol=1e-4)


def test_what_it_needs():
    bare = jd.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    bump = jd.BumpMap(jd.Bitmap(RAMP), jd.Diffuse())
    for bsdf in (jd.Mask(0.5, bump), jd.RoughConductor(0.1, alpha_v=0.2), jd.Principled(anisotropic=0.5)):
        with pytest.raises(ValueError, match=r"Scene: bare\.bsdf has a normal map, a bump map or two roughnesses, and"):
            jd.Scene({"bare": jd.Shape(bare, bsdf)}, CAMERA)
    flat = {"uvs": ((0.5, 0.5),), "uv_faces": ((0, 0, 0),)}  # UVs that tell no direction: no slope
    packed = pack(jd.Scene({"a": jd.Shape(jd.Mesh(VERTICES, [[0, 1, 2]], **flat), bump)}, CAMERA))
    point = material_point(packed, jnp.zeros(1, jnp.int32), jnp.full((1, 3), 1 / 3), jnp.ones(1, bool))
    assert np.all(np.asarray(Scatterer(packed, point, jnp.asarray([[0.0, 0.0, 1.0]])).groups[0][0].height) == 0)
