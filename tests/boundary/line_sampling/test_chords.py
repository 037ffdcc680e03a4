"""Cauchy-Crofton: the chords' weights add up to the length of a curve that is known, in area and in solid angle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.line_sampling.chords import (
    LobeChords,
    angle_ratio,
    emitter_chords,
    emitter_rate,
    emitter_weight,
    lobe_chords,
    lobe_rate,
    lobe_weight,
)
from jaxdr.boundary.shared.emitter_planes import emitter_face_at, emitter_groups
from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import build_edge_tree
from jaxdr.geometry.shapes import displaced_sphere, sphere
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point
from jaxdr.transport.shading import Scatterer
from tests.gradients.floor_point import LIGHT, QUADRANGLE, RADIANCE, scene, sheet

CHORDS = 200_000


def crossings(packed, apex, chords, implementation="warp"):
    """Every visible silhouette crossing of chords: (chord, edge, fraction along the edge), on the host."""
    edges, count = packed.edges, chords.first.shape[0]
    rank = jnp.ones(edges.vertices.shape[0])
    tree = build_edge_tree(packed.vertices, edges.vertices, edges.opposite, edges.interior, rank)
    group = emitter_groups(packed) if packed.has_area_emitters else jnp.full(packed.faces.shape[0], -1)
    useful = chords.useful.astype(jnp.float32)
    found = queries.sector_crossings(
        packed.geometry,
        queries.EdgeSet.of(edges, rank, tree),
        group,
        queries.SectorQuery(apex, chords.first, chords.last, chords.centre, useful, chords.group),
        jnp.int32(1),
        1,
        4 * count,
        implementation,
    )
    used = np.asarray(found.chord) >= 0
    return tuple(np.asarray(x)[used] for x in (found.chord, found.edge, found.along))


def boundary_points(packed, edge, along):
    """Where edges are crossed."""
    ends = np.asarray(packed.vertices)[np.asarray(packed.edges.vertices)[edge]]
    return ends[:, 0] + along[:, None] * (ends[:, 1] - ends[:, 0])


def check(per_chord, length):
    """The mean over chords is the length, within a standard error of half a per cent."""
    mean, error = per_chord.mean(), per_chord.std() / np.sqrt(len(per_chord))
    assert error < 0.01 * length
    assert abs(mean - length) < 4 * error, f"{mean} ± {error}, exactly {length}"


def light_of(triangles: int) -> jd.Mesh:
    """The light as two triangles, or as many: past `FEW_FACES` chords stay within a triangle."""
    n = round((triangles / 2) ** 0.5)
    s = np.linspace(0, 1, n + 1)
    a, b = np.meshgrid(s, s, indexing="ij")
    corner, along, across = LIGHT[0], LIGHT[1] - LIGHT[0], LIGHT[3] - LIGHT[0]
    points = corner + a.reshape(-1, 1) * along + b.reshape(-1, 1) * across
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    v00, v10, v01, v11 = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel()
    return jd.Mesh(points, np.concatenate([np.stack([v00, v10, v11], 1), np.stack([v00, v11, v01], 1)]))


@pytest.mark.parametrize(
    "triangles", [pytest.param(2, marks=pytest.mark.slow), pytest.param(8, marks=pytest.mark.slow), 50]
)
def test_length_of_a_shadow_on_a_light(triangles):
    """The outline of a quadrangle's shadow, projected from a floor point onto the plane of a square light."""
    of = scene(sheet(QUADRANGLE, 3.0))
    light = jd.Shape(light_of(triangles), jd.Diffuse(0.0), jd.AreaEmitter(RADIANCE))
    packed = pack(jd.Scene(shapes=dict(of.shapes) | {"light": light}, camera=of.camera))
    group = emitter_groups(packed)
    apex = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1e-6]), (CHORDS, 3))
    u = jax.random.uniform(jax.random.key(0), (CHORDS, 3))
    drawn = emitter_chords(packed, group, apex, u)
    chord, edge, along = crossings(packed, apex, drawn.chords)
    point = boundary_points(packed, edge, along)
    on_light = jnp.asarray(point * (LIGHT[0, 2] / point[:, 2:]), jnp.float32)
    face, barycentric, inside = emitter_face_at(packed, group, drawn.centre.face[chord], on_light)
    assert np.mean(np.asarray(inside)) > 0.9999 and np.min(barycentric) > -1e-3
    weight = np.asarray(emitter_weight(drawn.pdf, drawn.length))[chord]
    shadow = QUADRANGLE * (LIGHT[0, 2] / QUADRANGLE[:, 2:])
    check(np.bincount(chord, weight, minlength=CHORDS), np.linalg.norm(shadow - np.roll(shadow, 1, 0), axis=1).sum())

    # The rate counts crossings of the same curve as the apex sees it: all planes through a point of it add up to two.
    plane = drawn.chords.plane(apex)[chord]
    normal = material_point(packed, face, barycentric, inside).normal
    rate = emitter_rate(drawn.pdf[chord], drawn.length[chord], apex[chord], on_light, normal, plane)
    check(np.bincount(chord, 1.0 / np.asarray(rate), minlength=CHORDS), 2 * seen_length(QUADRANGLE))


def seen_length(polygon):
    """Length of a polygon's outline in directions from the origin."""
    unit = polygon / np.linalg.norm(polygon, axis=1, keepdims=True)
    return np.arccos((unit * np.roll(unit, 1, axis=0)).sum(1)).sum()


@pytest.mark.parametrize("width", [0.1, 1.0, 1.4], ids=str)
def test_length_of_a_silhouette_in_directions(width):
    """The outline of a quadrangle in the sky of a floor point: an arc of a great circle for each side."""
    blocker = jd.Mesh(QUADRANGLE, [[0, 1, 2], [0, 2, 3]])
    floor = jd.Mesh(5.0 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2]])
    camera = scene(sheet(QUADRANGLE, 3.0)).camera
    packed = pack(jd.Scene({"blocker": jd.Shape(blocker), "floor": jd.Shape(floor)}, camera, jd.ConstantEnvironment(1)))
    count = CHORDS
    barycentric = np.linalg.solve(np.vstack([np.asarray(floor.vertices).T[:2], np.ones(3)]), [0, 0, 1])
    barycentric = jnp.broadcast_to(jnp.asarray(barycentric, jnp.float32), (count, 3))
    point = material_point(packed, jnp.full(count, packed.first_face[1]), barycentric, jnp.ones(count, bool))
    scatterer = Scatterer(packed, point, jnp.broadcast_to(jnp.asarray([0.6, 0.0, 0.8]), (count, 3)))
    lobes = lobe_chords(scatterer, jnp.full(count, width), jax.random.uniform(jax.random.key(1), (count, 3)))
    apex = scatterer.leave(lobes.centre)
    chord, edge, along = crossings(packed, apex, lobes.chords(apex, jnp.float32(10.0)))
    of_blocker = np.asarray(packed.edges.shape)[edge] == 0  # the floor has a horizon
    chord, edge, along = chord[of_blocker], edge[of_blocker], along[of_blocker]
    towards = boundary_points(packed, edge, along) - np.asarray(apex)[chord]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    there = jax.tree.map(lambda x: x[chord] if x.ndim else x, point)
    scatterer = Scatterer(packed, there, jnp.broadcast_to(jnp.asarray([0.6, 0.0, 0.8]), (len(chord), 3)))
    lobes = LobeChords(*(x[chord] for x in lobes))
    towards = jnp.asarray(towards, jnp.float32)
    weight = lobe_weight(scatterer, lobes, towards)
    check(np.bincount(chord, np.asarray(weight), minlength=count), seen_length(QUADRANGLE))
    rate = lobe_rate(scatterer, lobes.reach, lobes.plane, towards)
    check(np.bincount(chord, 1.0 / np.asarray(rate), minlength=count), 2 * seen_length(QUADRANGLE))


def test_angles_on_a_slanted_light():
    """Measured on the light or in directions, the angles of chords through a boundary point add up to two."""
    rng = np.random.default_rng(0)
    count, steps = 20, 4000
    apex, point, normal, tangent = (rng.normal(size=(count, 3)) for _ in range(4))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    towards = (point - apex) / np.linalg.norm(point - apex, axis=1, keepdims=True)
    seen = tangent - (tangent * towards).sum(1, keepdims=True) * towards
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    across = np.cross(towards, seen)
    for phi_l in (0.0, 1.0):  # from where angles are counted does not matter
        phi = (np.arange(steps) + 0.5) * np.pi / steps
        chord = np.cos(phi - phi_l)[:, None, None] * seen + np.sin(phi - phi_l)[:, None, None] * across
        rows = (np.broadcast_to(x, chord.shape).reshape(-1, 3) for x in (apex, point, normal))
        plane = np.cross(towards, chord).reshape(-1, 3)
        with jax.enable_x64(True):
            ratio = np.asarray(angle_ratio(*map(jnp.asarray, rows), jnp.asarray(plane), jnp.tile(tangent, (steps, 1))))
        total = (ratio.reshape(steps, count) * np.abs(np.sin(phi - phi_l))[:, None]).mean(0) * np.pi
        np.testing.assert_allclose(total, 2.0, rtol=0.01)


def test_weights_of_wide_chords_are_bounded():
    """f / p of a diffuse lobe grows without bound towards the horizon; with the kernel it does not."""
    shapes = {"floor": jd.Shape(displaced_sphere(2)), "ball": jd.Shape(sphere(1))}
    packed = pack(jd.Scene(shapes, scene(sheet(QUADRANGLE, 3.0)).camera, jd.ConstantEnvironment(1)))
    count = 20_000
    face = jnp.arange(count, dtype=jnp.int32) % 320
    point = material_point(packed, face, jnp.full((count, 3), 1 / 3), jnp.ones(count, bool))
    scatterer = Scatterer(packed, point, point.normal)
    u = jax.random.uniform(jax.random.key(2), (2, count, 3))
    lobes = lobe_chords(scatterer, jnp.ones(count), u[0])
    t = (2 * u[1, :, 0] - 1) * lobes.reach
    across = jnp.cross(lobes.plane, lobes.centre)
    boundary = jnp.cos(t)[:, None] * lobes.centre + jnp.sin(t)[:, None] * across
    weight = lobe_weight(scatterer, lobes, boundary) * scatterer.eval(boundary)[:, 0]
    assert np.all(np.isfinite(weight)) and np.max(weight) < 2.0


def test_options():
    for options, message in (
        ({"chords": 0.0}, "chords must be positive"),
        ({"floor": 0.0}, "floor must be positive"),
        ({"pilot": -1.0}, "pilot must not be negative"),
        ({"reach": float("nan")}, "reach must be a number, got nan"),
    ):
        with pytest.raises(ValueError, match=f"LineSampling: {message}"):
            jd.LineSampling(**options)
