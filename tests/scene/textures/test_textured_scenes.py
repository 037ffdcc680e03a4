"""Textures in scenes: parameter names, what they need of a mesh, tables, groups, and a texture from outside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxdr as jd
from jaxdr.scene.packed import pack
from jaxdr.scene.textures import Texture
from jaxdr.transport.interaction import intersect, material_point, on_fixed_ray
from jaxdr.transport.texturing import bsdfs_at, texture_point

PIXELS = np.random.default_rng(0).uniform(0.1, 0.9, (3, 4, 3))
GREY = PIXELS[..., 0]
CAMERA = jd.Perspective(jd.look_at((0, 0, 4), (0, 0, 0), (0, 1, 0)), 30.0, jd.Film(4, 4, jd.Box()))
QUAD = jd.shapes.rectangle(2.0, 2.0)
BARE = jd.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def scene(**bsdfs):
    return jd.Scene({name: jd.Shape(QUAD, bsdf) for name, bsdf in bsdfs.items()}, CAMERA, jd.ConstantEnvironment(1.0))


def test_names_of_parameters():
    of = scene(
        a=jd.TwoSided(jd.Diffuse(jd.Bitmap(PIXELS))),
        b=jd.Mask(jd.Bitmap(GREY, to_uv=np.eye(3)), jd.RoughConductor(jd.Checkerboard(0.2, 0.3))),
        c=jd.Diffuse(jd.VertexColors(np.ones((4, 3)))),
    )
    names = {name for name in of.parameters() if ".bsdf." in name}
    assert names == {
        "a.bsdf.reflectance.pixels", "b.bsdf.opacity.pixels", "b.bsdf.opacity.to_uv", "b.bsdf.bsdf.alpha.color0",
        "b.bsdf.bsdf.alpha.color1", "b.bsdf.bsdf.eta", "b.bsdf.bsdf.k", "b.bsdf.bsdf.specular_reflectance",
        "c.bsdf.reflectance.colors",
    }  # fmt: skip
    new = of.replace({"b.bsdf.bsdf.alpha.color1": jnp.full(1, 0.7), "a.bsdf.reflectance.pixels": 0.5 * PIXELS})
    np.testing.assert_allclose(new.shapes["b"].bsdf.bsdf.alpha.color1, [0.7])
    np.testing.assert_allclose(new.shapes["a"].bsdf.bsdf.reflectance.pixels, 0.5 * PIXELS, rtol=1e-6)
    np.testing.assert_allclose(new.parameters()["b.bsdf.bsdf.alpha.color0"], [0.2])


def test_a_texture_used_twice_has_two_names():
    grey = jd.Bitmap(GREY)
    of = scene(a=jd.Principled(roughness=grey, metallic=grey)).replace({"a.bsdf.metallic.pixels": np.zeros((3, 4, 1))})
    np.testing.assert_allclose(of.parameters()["a.bsdf.roughness.pixels"][..., 0], GREY, rtol=1e-6)
    np.testing.assert_array_equal(of.parameters()["a.bsdf.metallic.pixels"], 0)


def test_without_textures_there_are_no_tables():
    packed = pack(scene(a=jd.Diffuse(0.5), b=jd.RoughConductor()))
    assert packed.uvs is None and packed.uv_faces is None and not packed.textured
    nowhere = jnp.zeros(1, jnp.int32)
    assert material_point(packed, nowhere, jnp.ones((1, 3)) / 3, jnp.ones(1, bool)).on_face is None
    colours = jd.Scene({"a": jd.Shape(BARE, jd.Diffuse(jd.VertexColors(np.ones(3))))}, CAMERA)
    assert pack(colours).uvs is None and pack(colours).textured


def test_only_the_uvs_that_are_used_are_packed():
    shapes = {
        "a": jd.Shape(QUAD, jd.Diffuse(0.5)), "b": jd.Shape(BARE, jd.Diffuse(jd.VertexColors(np.ones(3)))),
        "c": jd.Shape(QUAD, jd.Diffuse(jd.Bitmap(PIXELS))),
    }  # fmt: skip
    packed = pack(jd.Scene(shapes, CAMERA))
    np.testing.assert_array_equal(packed.uvs, QUAD.uvs)
    np.testing.assert_array_equal(packed.uv_faces, [[0] * 3] * 3 + np.asarray(QUAD.uv_faces).tolist())


def test_emitters():
    """Tables for constants and for textures, each only where there are such; UVs for an emitter's image alone."""
    shapes = {"a": jd.Shape(QUAD, jd.Diffuse(0.5)), "b": jd.Shape(QUAD, emitter=jd.AreaEmitter(jd.Bitmap(GREY)))}
    of = jd.Scene(shapes, CAMERA)
    assert {n for n in of.parameters() if "emitter" in n} == {"b.emitter.radiance.pixels"}
    packed = pack(of)
    assert packed.radiance is None and packed.textured and len(packed.glow) == 1
    np.testing.assert_array_equal(packed.uvs, QUAD.uvs)
    both = pack(jd.Scene(shapes | {"c": jd.Shape(QUAD, emitter=jd.AreaEmitter((1, 2, 3)))}, CAMERA))
    np.testing.assert_array_equal(both.radiance, [[0] * 3] * 2 + [[1, 2, 3]])
    middle = jnp.full((3, 3), 1 / 3)
    found = both.surface_radiance(jnp.asarray([0, 2, 4]), middle)
    image = jd.Bitmap(np.repeat(GREY[..., None], 3, -1))
    at = both.texture_point(jnp.asarray([2]), middle[:1])
    lit = jax.tree.map(lambda leaf: leaf[None], image).values(jnp.zeros(1, jnp.int32), at)[0]
    np.testing.assert_allclose(found, [[0, 0, 0], lit, [1, 2, 3]], rtol=1e-6)
    constant = pack(jd.Scene({"c": jd.Shape(QUAD, emitter=jd.AreaEmitter(2.0))}, CAMERA))
    assert constant.glow == () and not constant.textured
    with pytest.raises(
        ValueError, match="AreaEmitter: radiance must be at least 0, and the texture has values from -1"
    ):
        jd.AreaEmitter(jd.VertexColors([-1.0, 2.0]))
    with pytest.raises(ValueError, match=r"Scene: bare\.emitter\.radiance, a Bitmap, needs texture coordinates"):
        jd.Scene({"bare": jd.Shape(BARE, emitter=jd.AreaEmitter(jd.Bitmap(PIXELS)))}, CAMERA)


def test_textures_that_do_not_fit():
    with pytest.raises(
        ValueError, match=r"Scene: bare\.bsdf\.reflectance, a Bitmap, needs texture coordinates, and the"
    ):
        jd.Scene({"bare": jd.Shape(BARE, jd.Diffuse(jd.Bitmap(PIXELS)))}, CAMERA)
    inner = jd.Mask(0.5, jd.RoughConductor(jd.Checkerboard(0.2, 0.3)))
    with pytest.raises(ValueError, match=r"Scene: bare\.bsdf\.bsdf\.alpha, a Checkerboard, needs texture coordinates"):
        jd.Scene({"bare": jd.Shape(BARE, jd.TwoSided(inner))}, CAMERA)
    with pytest.raises(ValueError, match=r"q\.bsdf\.reflectance, a VertexColors, has 3 values, .* 'q' has 4 vertices"):
        scene(q=jd.Diffuse(jd.VertexColors(np.ones(3))))
    with pytest.raises(ValueError, match=r"q\.bsdf\.reflectance, a VertexColors, has 3 values"):
        scene(q=jd.Diffuse(jd.Product(jd.Checkerboard(), jd.VertexColors(np.ones(3)))))


def test_textures_of_one_kind_and_size_share_a_group():
    def bitmap(pixels, **settings):
        return jd.Diffuse(jd.Bitmap(pixels, **settings))

    packed = pack(
        scene(a=bitmap(PIXELS), b=bitmap(0.5 * PIXELS), c=bitmap(PIXELS[:2]), d=bitmap(PIXELS, wrap="clamp"),
              e=bitmap(PIXELS, to_uv=np.eye(3)), f=jd.Diffuse(0.2), g=jd.Diffuse(0.3))
    )  # fmt: skip
    members = sorted(np.flatnonzero(group.member).tolist() for group in packed.bsdfs)
    assert members == [[0, 1], [2], [3], [4], [5, 6]]


def at(packed, shape, barycentric):
    """The fields of the BSDF of a shape at points of its first face, by group."""
    n = len(barycentric)
    face = jnp.full(n, packed.first_face[shape], jnp.int32)
    point = material_point(packed, face, jnp.asarray(barycentric), jnp.ones(n, bool))
    return bsdfs_at(packed, point, packed.face_shape[face])


def test_each_shape_gets_its_own():
    """Stacked textures, vertex colours behind other shapes' vertices: by the shape's row, at its mesh's UVs."""
    colors = np.random.default_rng(1).uniform(size=(4, 3))
    of = scene(
        a=jd.Diffuse(jd.Bitmap(PIXELS)), b=jd.Diffuse(jd.Bitmap(0.5 * PIXELS)), c=jd.Diffuse(jd.VertexColors(colors)),
        d=jd.Diffuse(jd.VertexColors(2 * colors)), e=jd.Diffuse((0.1, 0.2, 0.3)),
    )  # fmt: skip
    packed, weights = pack(of), np.random.default_rng(2).dirichlet(np.ones(3), 6)
    uv = weights @ np.asarray(QUAD.uvs)[np.asarray(QUAD.uv_faces)[0]]
    image = jd.Bitmap(PIXELS)
    stacked = jax.tree.map(lambda leaf: leaf[None], image)
    point = texture_point(
        packed, material_point(packed, jnp.zeros(6, jnp.int32), jnp.asarray(weights), jnp.ones(6) > 0)
    )
    np.testing.assert_allclose(point.uv, uv, atol=1e-6)
    pictured = np.asarray(stacked.values(jnp.zeros(6, jnp.int32), point))
    interpolated = weights @ colors[np.asarray(QUAD.faces)[0]]
    constant = np.broadcast_to([0.1, 0.2, 0.3], (6, 3))
    for shape, expected in enumerate((pictured, 0.5 * pictured, interpolated, 2 * interpolated, constant)):
        ((found, _),) = [(bsdf, member) for bsdf, member in at(packed, shape, weights) if bool(member[0])]
        np.testing.assert_allclose(found.reflectance, expected, atol=1e-6)


def test_uvs_slide_on_a_fixed_ray_and_stay_at_a_material_point():
    """A quad with UVs (x + 1) / 2 moves along x: at a fixed ray the UV goes the other way, by half of it."""
    of = scene(a=jd.Diffuse(jd.Bitmap(PIXELS)))
    origin, direction = jnp.asarray([[0.2, 0.3, 4.0]]), jnp.asarray([[0.0, 0.0, -1.0]])

    def coordinates(shift):
        packed = pack(of.replace({"a.vertices": QUAD.vertices + shift * jnp.asarray([1.0, 0.0, 0.0])}))
        face = intersect(packed, origin, direction, jnp.ones(1, bool), "jax").face
        sliding = on_fixed_ray(packed, origin, direction, face)
        material = material_point(packed, face, sliding.barycentric, sliding.valid)
        return texture_point(packed, sliding).uv[0], texture_point(packed, material).uv[0]

    (sliding, material), (slides, stays) = jax.jvp(coordinates, (0.0,), (1.0,))
    np.testing.assert_allclose([sliding, material], [[0.6, 0.65]] * 2, rtol=1e-5)
    np.testing.assert_allclose(slides, [-0.5, 0.0], atol=1e-6)
    np.testing.assert_array_equal(stays, 0.0)


class Ramp(Texture):
    """A texture that the package knows nothing about: grows with u."""

    slope: Float[Array, "*k C"]

    @property
    def continuous(self):
        return True

    def data(self):
        return (self.slope,)

    def lookup(self, row, point):
        return self.slope[row] * point.uv[:, :1]


def test_a_texture_from_outside():
    """One class is all that a new model takes: named, stacked, looked up and differentiated."""
    of = scene(a=jd.Diffuse(Ramp(jnp.asarray([0.8]))), b=jd.Diffuse(0.5))
    assert of.parameters()["a.bsdf.reflectance.slope"].shape == (3,)

    @jax.jit
    def image(slope):
        alone = jd.Scene({"a": of.shapes["a"]}, CAMERA, of.environment).replace({"a.bsdf.reflectance.slope": slope})
        integrator = jd.PathTracer(max_depth=2, boundary=None)
        return jd.derivative_terms(alone, jax.random.key(0), 64, integrator)["interior"][1:3, 1:3]

    value, slope = jax.jvp(image, (jnp.ones(3),), (jnp.asarray([1.0, 0.0, 0.0]),))
    assert np.all(0.25 < value[:, 0]) and np.all(value[:, 0] < 0.5) and np.all(value[:, 1] > 0.5)
    np.testing.assert_allclose(slope, value * jnp.asarray([1.0, 0.0, 0.0]), rtol=1e-5)
