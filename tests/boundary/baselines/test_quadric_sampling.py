"""`QuadricSampling`: what its bounds leave out, probabilities of edges, exact derivatives of shadows, two bounces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.baselines.quadric_sampling import estimator as estimator_module
from jaxdr.boundary.baselines.quadric_sampling.dual_bounds import bound, dual_points, one_sided
from jaxdr.boundary.baselines.quadric_sampling.importance import Importance, emitter_balls
from jaxdr.boundary.baselines.quadric_sampling.silhouette_tree import draw_edges, silhouette_tree
from jaxdr.boundary.guided_edges.edge_lunes import edge_lunes
from jaxdr.geometry.shapes import box, rectangle, sphere
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point
from jaxdr.transport.shading import Scatterer
from tests.gradients.floor_point import BOX, QUADRANGLE, check_derivatives, estimates, exact, flat, mean_and_error
from tests.gradients.floor_point import scene as point_scene
from tests.gradients.lit_box import SCENE as LIT_BOX
from tests.gradients.lit_box import check_refusals, check_shadow


def patches(patch: int, count: int, spread: float):
    """(unit normals, points, centres, sizes) of `patch` faces around each of `count` places on a bumpy surface."""
    rng = np.random.default_rng(0)
    normal = rng.standard_normal((count, 1, 3)) + spread * rng.standard_normal((count, patch, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    point = 5.0 + rng.standard_normal((count, 1, 3)) + 0.1 * rng.standard_normal((count, patch, 3))
    return (*map(jnp.asarray, (normal, point)), jnp.asarray(point.mean(1)), jnp.full(count, 0.2))


@pytest.mark.parametrize("spread", [0.0, 0.02, 0.3, 3.0])
def test_bounds_leave_out_no_silhouette(spread):
    """Points that see both sides of some faces are never left out; of the others most are."""
    normal, point, centre, size = patches(8, 4000, spread)
    planes = dual_points(normal, point, centre[:, None], size[:, None])
    bounds = bound(planes, jnp.ones(planes.shape[:2], bool), False)
    offset = np.random.default_rng(1).standard_normal((4000, 3)) * np.geomspace(0.1, 30.0, 4000)[:, None]
    height = np.einsum("nki,nki->nk", normal, (centre + offset * size[:, None])[:, None] - point)
    same = (height > 0).all(1) | (height < 0).all(1)
    left_out = np.asarray(one_sided(bounds, jnp.asarray(offset), jnp.zeros(4000)))
    assert not np.any(left_out & ~same)
    if spread > 1:  # faces of all directions: there is little to leave out
        return
    assert left_out.sum() > 0.75 * same.sum(), (left_out.sum(), same.sum())
    only_box = bounds._replace(matrix=1e6 * bounds.matrix)
    only_quadric = bounds._replace(lower=bounds.lower - 1e3, upper=bounds.upper + 1e3)
    for part in (only_box, only_quadric):  # each of them rejects something that the other does not
        assert (
            np.any(left_out & ~np.asarray(one_sided(part, jnp.asarray(offset), jnp.zeros(4000)))) or spread == 0
        )  # equal normals


def test_the_bound_of_one_edge_is_its_quadric():
    """(q0 . X) (q1 . X) > 0 and nothing else is left out, but for rounding."""
    normal, point, centre, size = patches(2, 4000, 0.5)
    point = jnp.broadcast_to(point[:, :1], point.shape)  # both faces meet in it
    planes = dual_points(normal, point, centre[:, None], size[:, None])
    bounds = bound(planes, jnp.ones(planes.shape[:2], bool), True)
    offset = np.random.default_rng(1).standard_normal((4000, 3)) * 4.0
    height = np.einsum("nki,nki->nk", normal, (centre + offset * size[:, None])[:, None] - point)
    clear = np.abs(height).min(1) > 1e-5
    found = np.asarray(one_sided(bounds, jnp.asarray(offset), jnp.zeros(4000)))
    assert np.array_equal(found[clear], height.prod(1)[clear] > 0)


@jax.jit
def drawn_from(of, position, u):
    """(edges drawn by a point on the floor, their probabilities, heights of the point over two faces of all edges)."""
    packed = pack(of)
    lunes = edge_lunes(packed, (True,) * 3)
    count = u.shape[0]
    first = packed.first_face[1]  # the floor's
    weights = jnp.broadcast_to(jnp.asarray(position), (count, 3))
    point = material_point(packed, jnp.full(count, first), weights, jnp.ones(count, bool))
    scatterer = Scatterer(packed, point, jnp.broadcast_to(jnp.asarray([0.3, 0.0, 0.95]), (count, 3)))
    importance = Importance(scatterer, emitter_balls(packed), jnp.ones(count, bool))
    drawn = draw_edges(silhouette_tree(packed, lunes), importance, u)
    ends, opposite = packed.vertices[packed.edges.vertices], packed.vertices[packed.edges.opposite[:, :2]]
    away = point.position[0] - ends[:, 0]
    side = ends[:, 1] - ends[:, 0]
    heights = [(sign * jnp.cross(side, opposite[:, k] - ends[:, 0]) * away).sum(-1) for k, sign in ((0, 1), (1, -1))]
    return drawn, jnp.stack(heights, -1), packed.edges.interior, ends


@pytest.mark.slow
@pytest.mark.parametrize("position", [(0.2, 0.5, 0.3), (0.6, 0.1, 0.3)])
def test_probabilities_of_edges(position):
    """Every silhouette above the horizon is drawn, as often as its probability says; no other interior edge is."""
    shapes = {
        "ball": jd.Shape(sphere(2, radius=0.5, center=(0.4, 0.2, 1.2))),
        "floor": jd.Shape(rectangle(4.0, 4.0)),
        "lamp": jd.Shape(box((0.3, 0.3, 0.3), center=(0.0, 0.0, 3.0)), jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
    }
    of = jd.Scene(shapes, LIT_BOX.camera)
    u = jax.random.uniform(jax.random.key(2), (1 << 17, 3))
    drawn, heights, interior, ends = jax.device_get(drawn_from(of, position, u))
    silhouettes = interior & (heights.prod(1) < 0) & (ends[..., 2].max(1) > 1e-3)
    there = drawn.edge >= 0
    assert silhouettes.sum() > 20 and np.all(silhouettes[drawn.edge[there]] | ~interior[drawn.edge[there]])
    number = np.bincount(drawn.edge[there], minlength=len(interior))
    assert np.all(number[silhouettes] > 0)
    expected = np.zeros(len(interior))
    expected[drawn.edge[there]] = len(u) * drawn.probability[there]  # the same for all draws of an edge
    z = (number - expected)[silhouettes] / np.sqrt(expected[silhouettes])
    assert np.abs(z).max() < 4.5 and abs((z**2).mean() - 1) < 0.6, z


def test_derivatives_are_the_closed_form():
    """A closed blocker's shadow, by every vertex of it and of the light, without any bias allowed for."""
    check_derivatives(BOX, jd.QuadricSampling(2), tolerance=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [None, "probability", "angle"])
def test_open_blockers_and_broken_densities(monkeypatch, wrong):
    """Right for the four open edges of a quadrangle; wrong, and seen to be, where a density is off by a tenth."""
    boundary = jd.QuadricSampling(2 if wrong is None else 3 if wrong == "angle" else 4)  # a program for each
    if wrong == "probability":
        exactly = estimator_module.draw_edges

        def draw(*arguments):
            drawn = exactly(*arguments)
            return drawn._replace(probability=1.1 * drawn.probability)

        monkeypatch.setattr(estimator_module, "draw_edges", draw)
    if wrong == "angle":
        evenly = estimator_module.on_edges

        def on_edges(*arguments):
            along, angle = evenly(*arguments)
            return along**1.1, angle

        monkeypatch.setattr(estimator_module, "on_edges", on_edges)
    truth = exact(flat(QUADRANGLE))[1]["blocker.vertices"]
    _, rows = estimates(point_scene(flat(QUADRANGLE)), boundary)
    mean, error = mean_and_error(rows["blocker.vertices"] / np.abs(truth).max())
    off = np.abs(mean - truth / np.abs(truth).max())
    assert error.max() < 0.01, error
    assert np.all(off < 4.5 * error) == (wrong is None), (off, error)


@pytest.mark.slow
@pytest.mark.parametrize("depth", [2, 3])
def test_a_soft_shadow_moves_as_differences_say(depth):
    """By quarters of the film, and as a whole; at depth 3 also what the lit box sends to the floor."""
    check_shadow(jd.QuadricSampling(4), depth)


def test_what_is_not_covered():
    with pytest.raises(ValueError, match="QuadricSampling: samples must be at least 1"):
        jd.QuadricSampling(0)
    check_refusals(jd.QuadricSampling())
