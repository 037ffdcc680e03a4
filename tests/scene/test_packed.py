"""Packed scenes: indices into the joint tables, groups of BSDFs, emitters."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from experiments import program_size
from jaxdr.geometry.shapes import box, displaced_sphere, rectangle, sphere
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.packed import concave_edges, pack
from jaxdr.scene.sampling import EVENLY

CAMERA = jd.Perspective(jd.look_at([0, -4, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(4, 4))


QUAD = rectangle(1.0, 1.0)


class Mirrorless(BSDF):
    """Another kind of BSDF, with another number of parameters."""

    strength: jax.Array

    def eval(self, wi, wo):
        return jnp.zeros_like(wo) + self.strength[..., None]

    def pdf(self, wi, wo):
        return jnp.ones_like(wo[..., 0])

    def sample(self, wi, u):
        return wi


def scene(environment=None) -> jd.Scene:
    return jd.Scene(
        {
            "a": jd.Shape(box(), jd.Diffuse(0.1)),
            "b": jd.Shape(sphere(1).smooth(), jd.TwoSided(jd.Diffuse(0.2))),
            "c": jd.Shape(rectangle(2.0, 3.0), jd.Diffuse(0.3), jd.AreaEmitter((1.0, 2.0, 4.0))),
            "d": jd.Shape(rectangle(1.0, 1.0), Mirrorless(jnp.asarray(0.7)), jd.AreaEmitter(0.5)),
        },
        CAMERA,
        environment,
    )


def test_tables_are_those_of_the_shapes():
    of = scene()
    packed = pack(of)
    for number, shape in enumerate(of.shapes.values()):
        mine = np.flatnonzero(np.asarray(packed.face_shape) == number)
        corners = np.asarray(packed.vertices)[np.asarray(packed.faces)[mine]]
        np.testing.assert_array_equal(corners, np.asarray(shape.mesh.vertices)[np.asarray(shape.mesh.faces)])
        edges = np.asarray(packed.edges.shape) == number
        ends = np.asarray(packed.vertices)[np.asarray(packed.edges.vertices)[edges]]
        expected = np.asarray(shape.mesh.vertices)[np.asarray(shape.mesh.edges.vertices)]
        np.testing.assert_array_equal(ends, expected)
    assert packed.closed == (True, True, False, False)
    assert packed.smooth == (False, True, False, False)
    np.testing.assert_array_equal(packed.two_sided, [False, True, False, False])


def test_edges_know_their_faces():
    packed = jax.device_get(pack(scene()))
    edges = packed.edges
    assert edges.faces.shape == edges.opposite.shape
    for ends, faces, opposite, shape in zip(edges.vertices, edges.faces, edges.opposite, edges.shape, strict=True):
        for face, vertex in zip(faces, opposite, strict=True):
            assert (face < 0) == (vertex < 0)
            if face >= 0:
                assert {*ends, vertex} == set(packed.faces[face]) and packed.face_shape[face] == shape


def test_normals_of_smooth_shapes_only():
    of = scene()
    packed = pack(of)
    smooth = np.asarray(packed.face_shape) == 1
    groups = np.asarray(packed.normal_faces)
    assert np.all(groups[~smooth] == -1) and np.all(groups[smooth] >= 0)
    corners = np.asarray(packed.vertices)[np.asarray(packed.faces)[smooth]]
    np.testing.assert_allclose(np.asarray(packed.normals)[groups[smooth]], corners, atol=0.02)  # a unit sphere
    flat = pack(jd.Scene({"a": jd.Shape(box())}, CAMERA))
    assert flat.normals is None and flat.normal_faces is None


def test_bsdfs_are_grouped_by_kind():
    packed = pack(scene())
    assert len(packed.bsdfs) == 2
    diffuse, other = sorted(packed.bsdfs, key=lambda group: isinstance(group.bsdf, Mirrorless))
    np.testing.assert_array_equal(diffuse.member, [True, True, True, False])
    np.testing.assert_array_equal(other.member, [False, False, False, True])
    np.testing.assert_allclose(np.asarray(diffuse.bsdf.reflectance)[np.asarray(diffuse.row)[:3], 0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(other.bsdf.strength[other.row[3]], 0.7)


def test_emitters():
    """Faces of emitting shapes, chosen in proportion to area times luminance, and a part of the choice to area."""
    packed = pack(scene())
    np.testing.assert_array_equal(np.asarray(packed.face_shape)[np.asarray(packed.emitter_faces)], [2, 2, 3, 3])
    np.testing.assert_allclose(packed.radiance, [[0, 0, 0], [0, 0, 0], [1, 2, 4], [0.5, 0.5, 0.5]])
    luminance = np.array([0.2126, 0.7152, 0.0722])
    area = np.array([3.0, 3.0, 0.5, 0.5])
    power = area * (np.array([[1, 2, 4]] * 2 + [[0.5] * 3] * 2) @ luminance)
    chance = (1 - EVENLY) * power / power.sum() + EVENLY * area / area.sum()
    np.testing.assert_allclose(packed.emitter_cdf, np.cumsum(chance), rtol=1e-5)
    assert packed.has_area_emitters
    dark = pack(jd.Scene({"a": jd.Shape(box())}, CAMERA))
    assert not dark.has_area_emitters and dark.emitter_faces is None and dark.radiance is None


def test_emitters_that_are_off_are_chosen_by_area():
    off = scene().replace({"c.emitter.radiance": jnp.zeros(3), "d.emitter.radiance": jnp.zeros(3)})
    np.testing.assert_allclose(pack(off).emitter_cdf, np.cumsum([3, 3, 0.5, 0.5]) / 7, rtol=1e-5)


def test_textured_emitters_are_chosen_by_their_mean():
    """Faces by area times mean luminance, and a tenth by area alone: black ones have a share."""
    colors = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    of = scene()
    glowing = jd.Shape(rectangle(2.0, 3.0), jd.Diffuse(0.3), jd.AreaEmitter(jd.VertexColors(colors)))
    packed = pack(jd.Scene(dict(of.shapes) | {"c": glowing}, CAMERA))
    first = np.asarray(of.shapes["c"].mesh.faces)
    weights = np.array([0.2126, 0.7152, 0.0722])
    power = np.concatenate([3.0 * (colors[first] @ weights).mean(1), [0.5 * 0.5] * 2])
    area = np.array([3.0, 3.0, 0.5, 0.5])
    share = 0.9 * power / power.sum() + 0.1 * area / area.sum()
    np.testing.assert_allclose(np.diff(packed.emitter_cdf, prepend=0), share, rtol=1e-5)
    off = pack(jd.Scene({"c": jd.Shape(QUAD, emitter=jd.AreaEmitter(jd.VertexColors(np.zeros(4))))}, CAMERA))
    np.testing.assert_allclose(off.emitter_cdf, [0.5, 1.0])


def test_choice_of_emitters_is_detached():
    def total(radiance):
        return pack(scene().replace({"c.emitter.radiance": radiance})).emitter_cdf.sum()

    assert np.all(np.asarray(jax.grad(total)(jnp.ones(3))) == 0)


def test_sizes():
    packed = pack(scene())
    np.testing.assert_allclose(packed.shape_sizes()[jnp.asarray([0, 2, 3])], np.sqrt([3, 13, 2]), rtol=1e-5)
    np.testing.assert_allclose(packed.size, np.linalg.norm([2, 3, 2]), rtol=0.05)  # of the ball and the rectangle


def test_packing_is_differentiable():
    of = scene()
    area = jax.grad(lambda v: 2.0 * pack(of.replace({"c.vertices": v})).table[:, 12].sum())
    gradient = np.asarray(area(of.parameters()["c.vertices"]))
    # Twice the area of a rectangle of 2 x 3: a side's outward motion adds twice its length, half at either end.
    np.testing.assert_allclose(np.abs(gradient), [[3, 2, 0]] * 4, atol=1e-4)


def test_concave_edges():
    """None of a box, some of a bumpy sphere, none of open sheets."""
    of = jd.Scene(
        {"box": jd.Shape(box()), "bumps": jd.Shape(displaced_sphere(2)), "open": jd.Shape(rectangle())}, CAMERA
    )
    packed = pack(of)
    share = [np.asarray(concave_edges(packed))[np.asarray(packed.edges.shape) == k].mean() for k in range(3)]
    assert share[0] == share[2] == 0 and 0.05 < share[1] < 0.5


def test_operations_do_not_grow_with_the_shapes():
    def equations(count):
        shapes = {f"box{i}": jd.Shape(box(center=(i, 0, 0)), jd.Diffuse(0.5)) for i in range(count)}
        leaves, structure = jax.tree.flatten(jd.Scene(shapes, CAMERA))
        jaxpr = jax.make_jaxpr(lambda leaves: pack(jax.tree.unflatten(structure, leaves)))(leaves).jaxpr
        return len(list(program_size.equations(jaxpr)))

    assert equations(12) == equations(2)
