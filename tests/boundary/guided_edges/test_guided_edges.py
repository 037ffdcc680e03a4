"""`GuidedEdges`: the space that segments are drawn from, densities and inverses, exact derivatives of a shadow."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments import one_term
from jaxdr.boundary.guided_edges import estimator
from jaxdr.boundary.guided_edges.boundary_segments import DirectionSampling, EmitterSampling, segment_ends, segments
from jaxdr.boundary.guided_edges.edge_lunes import edge_lunes
from jaxdr.geometry.shapes import sphere
from jaxdr.scene.packed import pack
from jaxdr.transport.emission import sample_emitter
from jaxdr.transport.emitter_numbers import emitter_numbers
from jaxdr.transport.path_settings import PathSettings
from tests.gradients.floor_patch import FILM, exact
from tests.gradients.floor_patch import scene as patch_scene
from tests.gradients.floor_point import BOX, QUADRANGLE, sheet
from tests.stability.catalogue import catalogue

SETTINGS = PathSettings(2, True, "auto")
BLOCKER = sheet(QUADRANGLE, 0.1)
GUIDES = [
    jd.GuidedEdges("none", "emitter"),
    jd.GuidedEdges("none", "mis"),
    jd.GuidedEdges("grid", "emitter", cells=(64, 4, 4), guide_samples=64),
    jd.GuidedEdges("kdtree", "mis", leaves=256),
    jd.GuidedEdges("projective", "mis", leaves=1024, sort=True),
]


def test_total_measure_is_mean_width():
    """Cauchy-Crofton: length times width of lunes, summed over a convex body, is 2 pi times its mean width."""
    with jax.enable_x64(True):
        corners = np.array(list(np.ndindex(2, 2, 2)), float) * [1.0, 2.0, 3.0]
        faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
        faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
        of = jd.Scene({"box": jd.Shape(jd.Mesh(corners, faces))}, patch_scene(BLOCKER).camera)
        lunes = edge_lunes(pack(of), (True,))
        # Twelve sides fold by a right angle; the diagonals of the sides not at all.
        assert np.isclose(float((jnp.linalg.norm(lunes.side, axis=1) * lunes.width).sum()), 4 * 6 * np.pi / 2)


@jax.jit
def drawn_by_direction(of, u):
    """(lunes, lines, the numbers that they come from) of two moving shapes."""
    packed = pack(of)
    lunes = edge_lunes(packed, (True, True))
    drawn = segments(packed, lunes, [DirectionSampling], u)
    height = ((packed.vertices[packed.edges.opposite[lunes.edge]] - lunes.start[:, None])[drawn.point.row]).swapaxes(
        0, 1
    )
    there = packed.edges.opposite[lunes.edge][drawn.point.row].T >= 0
    height = jnp.where(there, (height * drawn.pole).sum(-1), 0.0) / drawn.scale
    return drawn, height, DirectionSampling.numbers(packed, lunes, drawn)


def test_silhouettes_are_what_they_are():
    """A line is a silhouette where the faces at its edge lie on one side of the plane; then the pole points to them."""
    with jax.enable_x64(True):
        of = jd.Scene({"ball": jd.Shape(sphere(1)), "sheet": jd.Shape(BLOCKER)}, patch_scene(BLOCKER).camera)
        u = np.random.default_rng(0).uniform(size=(4096, 3))
        drawn, height, numbers = jax.device_get(drawn_by_direction(of, jnp.asarray(u)))
        assert drawn.silhouette.mean() > 0.999
        assert height.min() > -1e-5
        assert np.abs((drawn.pole * drawn.towards).sum(-1)).max() < 1e-5
        assert np.mean(np.abs(numbers - u).max(1) > 2e-4) < 0.01


@pytest.mark.parametrize("sky", [None, jd.ConstantEnvironment(0.7), "map"])
def test_emitter_numbers_invert_the_samples(sky):
    """With areas alone, and with both kinds of environment beside them."""
    image = 0.1 + np.random.default_rng(0).uniform(size=(8, 16, 3))
    sky = jd.EnvironmentMap(image) if isinstance(sky, str) else sky
    of = patch_scene(BLOCKER)
    with jax.enable_x64(True):
        packed = pack(jd.Scene(of.shapes, of.camera, sky))
        u = jax.random.uniform(jax.random.key(0), (1000, 2), jnp.float64)
        sample = sample_emitter(packed, u)
        found, there = emitter_numbers(packed, sample.point, sample.direction)
        assert bool(there.all())
        assert float(jnp.abs(found - u).max()) < 1e-5


def test_mis_weights_add_up():
    """Each strategy knows the other's density: for the same segment both report the same two numbers."""
    packed = pack(patch_scene(BLOCKER))
    lunes = edge_lunes(packed, (True,) * 3)
    u = jax.random.uniform(jax.random.key(0), (1 << 15, 3))
    drawn = segments(packed, lunes, [EmitterSampling], u)
    ends = segment_ends(packed, drawn, drawn.silhouette, "auto")
    again = segments(packed, lunes, [DirectionSampling], DirectionSampling.numbers(packed, lunes, drawn, ends))
    seen = segment_ends(packed, again, again.silhouette, "auto")
    glows = np.isin(np.asarray(seen.source.face), np.asarray(packed.emitter_faces)) & np.asarray(seen.source.valid)
    both = np.asarray(ends.valid & seen.valid) & glows
    assert both.sum() > 1000 and both.sum() > 0.98 * np.asarray(ends.valid).sum()
    for strategy in (DirectionSampling, EmitterSampling):
        one, two = (strategy.density(packed, lunes, d, e) for d, e in ((drawn, ends), (again, seen)))
        ratio = np.asarray(one / two)[both]
        assert np.quantile(np.abs(ratio - 1), 0.98) < 1e-2
    back = EmitterSampling.numbers(packed, lunes, again, seen)
    assert np.quantile(np.abs(np.asarray(back - u))[both].max(1), 0.98) < 1e-2


@pytest.mark.parametrize("strategy", [DirectionSampling, EmitterSampling])
def test_an_edge_casts_no_shadow_on_a_face_that_ends_there(strategy):
    """Also where only a face without area says that it does."""
    packed = pack(catalogue()["zero_area"].scene)
    lunes = edge_lunes(packed, (True,) * 3)
    drawn = segments(packed, lunes, [strategy], jax.random.uniform(jax.random.key(0), (1 << 16, 3)))
    ends = segment_ends(packed, drawn, drawn.silhouette, "auto")
    valid = np.asarray(ends.valid)
    vertices = np.asarray(packed.vertices)
    corners = vertices[np.asarray(packed.faces)[np.asarray(ends.detector.face)]]
    edge = vertices[np.asarray(lunes.vertices)[np.asarray(drawn.point.row)]]
    apart = np.abs(corners[:, None] - edge[:, :, None]).max(-1).min(-1).max(-1)
    assert valid.sum() > 3000 and apart[valid].min() > 0.01


@partial(jax.jit, static_argnums=(1, 2))
def derivatives(of, boundary, count, keys):
    """From `count` segments of every strategy for each key."""
    vertices = jnp.asarray(of.parameters()["blocker.vertices"])
    prepared = boundary.prepare(one_term.context(of, (True,) * 3, SETTINGS), jax.random.key(0))

    def mean(vertices, key):
        moved = one_term.context(of.replace({"blocker.vertices": vertices}), (True,) * 3, SETTINGS)
        return one_term.image(boundary, moved, prepared, count // FILM**2, key).mean()

    return jax.lax.map(lambda key: jax.grad(mean)(vertices, key), keys)


def check_derivatives(boundary, most: float):
    """Every vertex of the blocker, in reverse mode, without any bias allowed for. `most`: of the mean's deviation."""
    truth = exact(BLOCKER)
    scale = np.abs(truth).max()
    keys = jax.random.split(jax.random.key(1), 48)  # so many that their own deviation is known well
    rows = np.asarray(derivatives(patch_scene(BLOCKER), boundary, 1 << 13, keys), float) / scale
    deviation = rows.std(0, ddof=1) / len(keys) ** 0.5
    assert deviation.max() < most, deviation
    wrong = np.abs(rows.mean(0) - truth / scale)
    assert np.all(wrong < 4.5 * deviation + 1e-6), (wrong, deviation)


@pytest.mark.parametrize("boundary", GUIDES, ids=lambda b: f"{b.guide}, {b.sampling}")
def test_derivatives_are_the_closed_form(boundary):
    check_derivatives(boundary, 0.03)


def test_many_tries_for_a_segment_are_the_closed_form(monkeypatch):
    """So few edges have one try for a segment. Here it is 16, and borders are kept with a probability of 1 / 16."""
    monkeypatch.setattr(estimator, "TRIED", 10.0)
    check_derivatives(jd.GuidedEdges(samples=1.003), 0.05)  # options that no other test compiles


def test_bad_options():
    with pytest.raises(ValueError, match="need three cells"):
        jd.GuidedEdges("grid", cells=(16, 0, 4))
    with pytest.raises(ValueError, match="samples"):
        jd.GuidedEdges(samples=0.0)
    of = patch_scene(BOX)
    of = jd.Scene(dict(of.shapes) | {"floor": jd.Shape(of.shapes["floor"].mesh, jd.Conductor())}, of.camera)
    with pytest.raises(ValueError, match="GuidedEdges covers no visibility changes over mirrors"):
        jd.GuidedEdges().prepare(one_term.context(of, (True,) * 3, SETTINGS), jax.random.key(0))
