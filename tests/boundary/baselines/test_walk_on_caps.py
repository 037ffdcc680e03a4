"""`WalkOnCaps`: the field is continuous and has the silhouettes' velocities, its divergence, exact derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments import one_term
from jaxdr.boundary.baselines.walk_on_caps import walks as walking
from jaxdr.boundary.baselines.walk_on_caps.caps import in_cap, tangents, turned
from jaxdr.boundary.baselines.walk_on_caps.walks import Views, Walks, walked_velocities
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.geometry.vector import interpolate
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import uniform
from tests.gradients.floor_point import HALF_PLANE, POINT, QUADRANGLE, UP, estimates, exact, mean_and_error, sheet
from tests.gradients.floor_point import scene as point_scene
from tests.gradients.lit_box import KEYS, by_x, check_shadow
from tests.gradients.lit_box import SCENE as LIT_BOX
from tests.gradients.test_redner_was import cube_derivatives, cube_scene, of_cube

SETTINGS = PathSettings(2, True, "auto")
WALKERS = 1 << 13  # directions, or walks


def velocity(point):
    """Any smooth velocity of silhouette points, as a function of where they are."""
    x, y, z = (point[..., k] for k in range(3))
    return jnp.stack([0.4 - y + x * z, 0.3 * z + x, x - 0.5 * y * y], -1)


@pytest.fixture
def field():
    """u_k and its divergence at directions [N, 3] from the floor point, and the angle to the closest silhouette."""
    context = one_term.context(point_scene(sheet(QUADRANGLE, 0.1)), (True,) * 3, SETTINGS)
    edges = jd.WalkOnCaps().prepare(context, jax.random.key(0))
    packed = context.packed

    def views(n, walks):
        apex, normal = (jnp.broadcast_to(jnp.asarray(a, jnp.float32), (n, 3)) for a in (POINT, UP))
        return Views(packed, edges, apex, normal, jnp.full(n, True), walks)

    def at(direction, walks, key):
        n = direction.shape[0]
        nowhere = jnp.zeros(n, jnp.int32)
        apex = jnp.broadcast_to(jnp.asarray(POINT, jnp.float32), (n, 3))
        infinite = jnp.full(n, True)
        triangle = jnp.zeros((n, 3, 3), direction.dtype)
        ends = SegmentEnds(apex, nowhere, apex + direction, direction, nowhere, triangle, infinite)
        found = walked_velocities(views(n, walks), direction, ends, key)
        place = interpolate(packed.vertices[packed.faces[found.table.occluder]], found.table.on_occluder)
        moves = velocity(place).reshape(n, -1, 3)
        share, rate = found.share.reshape(n, -1), found.rate.reshape(n, -1, 3)
        return jnp.einsum("nq,nqk->nk", share, moves), jnp.einsum("nqk,nqk->n", rate, moves)

    def closest(direction, walks):
        found = views(direction.shape[0], walks).closest(direction[:, None])
        ends = packed.vertices[edges.ends[found.edge[:, 0]]]
        place = ends[:, 0] + found.along * (ends[:, 1] - ends[:, 0])
        return found.angle[:, 0], place, found.edge[:, 0]

    return jax.jit(at, static_argnums=1), jax.jit(closest, static_argnums=1)


def on_caps(middle, radius, key):
    """Unit directions even in a spherical cap, and on its rim with the rim's outward normals there."""
    u = uniform(key, (3, WALKERS))
    centre = jnp.broadcast_to(jnp.asarray(middle / np.linalg.norm(middle), jnp.float32), (WALKERS, 3))
    inside = in_cap(centre, jnp.full(WALKERS, radius), u[0], u[1])
    towards = tangents(centre, (jnp.arange(WALKERS) + u[2]) / WALKERS)
    rim, normal = (turned(centre, towards, jnp.full(WALKERS, angle)) for angle in (radius, radius + np.pi / 2))
    return inside, rim, normal


ONE_STEP, SHORT_STEPS = Walks(1, 4, 1.0, np.pi), Walks(3, 4, 0.7, 0.4)
CAPS = {"beside the blocker": ([0.05, -0.9, 1.0], 0.15), "over a corner": ([0.45, -0.2, 0.65], 0.3)}


@pytest.mark.parametrize(
    ("name", "options", "wrong"),
    [
        ("beside the blocker", ONE_STEP, None),
        ("beside the blocker", SHORT_STEPS, None),
        ("over a corner", ONE_STEP, None),
        ("over a corner", SHORT_STEPS, None),
        ("beside the blocker", ONE_STEP, "rim"),
        ("beside the blocker", ONE_STEP, "grow"),
    ],
)
def test_what_diverges_in_a_cap_leaves_it(field, monkeypatch, name, options, wrong):
    """Gauss' theorem, over silhouettes and kinks; not so with a wrong length of rims, or radii that do not change."""
    at, _ = field
    if wrong == "rim":
        exactly = walking.rim_over_area
        monkeypatch.setattr(walking, "rim_over_area", lambda radius: 1.2 * exactly(radius))
    if wrong == "grow":
        closest = Views.closest

        def still(views, direction):
            found = closest(views, direction)
            return found._replace(away=jnp.zeros_like(found.away))

        monkeypatch.setattr(Views, "closest", still)
    middle, radius = CAPS[name]
    inner, outer = [], []
    for key in jax.random.split(jax.random.key(5), 8):
        inside, rim, normal = on_caps(np.array(middle), radius, key)
        inner.append(2 * np.pi * (1 - np.cos(radius)) * float(at(inside, options, key)[1].mean()))
        flux = jnp.sum(at(rim, options, jax.random.fold_in(key, 1))[0] * normal, -1)
        outer.append(2 * np.pi * np.sin(radius) * float(flux.mean()))
    (mean, error), (expected, noise) = mean_and_error(np.array(inner)), mean_and_error(np.array(outer))
    size = 2 * np.pi * np.sin(radius) * 0.3
    assert np.hypot(error, noise) < 0.02 * size, (error, noise, size)
    good = abs(mean - expected) < 4.5 * np.hypot(error, noise)
    assert good == (wrong is None), (mean, expected, error, noise)


def test_it_has_the_silhouettes_velocities_and_is_continuous(field):
    """On both sides of an edge of the blocker; and where the closest silhouette changes, though its velocity jumps."""
    at, closest = field
    walks = Walks(2, 1 << 12, 1.0, np.pi)
    middle = 0.5 * (QUADRANGLE[0] + QUADRANGLE[1])
    away = np.array([0.1, -1.0, 0.1])
    beside = np.stack([middle + s * away for s in (1e-3, -1e-3, 1e-2, -1e-2)])
    beside = jnp.asarray(beside / np.linalg.norm(beside, axis=1, keepdims=True), jnp.float32)
    found, divergence = at(beside, walks, jax.random.key(0))
    off = np.linalg.norm(found - velocity(jnp.asarray(middle)), axis=1)
    assert np.all(off < [0.01, 0.01, 0.1, 0.1]) and np.all(np.abs(divergence) < 10.0), (off, divergence)

    # The closest silhouette changes between two directions: halve their distance until they are next to each other.
    first, last = (v / np.linalg.norm(v) for v in (middle + np.array([0.0, -0.02, 0.0]), np.array([0.05, -1.45, 1.2])))
    for _ in range(9):
        half = first + last
        half /= np.linalg.norm(half)
        edge = np.asarray(closest(jnp.asarray(np.stack([first, half]), jnp.float32), walks)[2])
        first, last = (half, last) if edge[0] == edge[1] else (first, half)
    pair = jnp.asarray(np.stack([first, last]), jnp.float32)
    _, place, edge = closest(pair, walks)
    jump = np.linalg.norm(np.diff(velocity(place), axis=0))
    rows = [np.asarray(at(pair, Walks(1, WALKERS, 1.0, np.pi), key)[0], float) for key in KEYS[:4]]
    value, error = mean_and_error(np.stack(rows))
    assert edge[0] != edge[1] and jump > 0.3, (edge, jump)
    assert np.linalg.norm(np.diff(value, axis=0)) < 0.03 * jump + 4.5 * np.linalg.norm(error), (value, error, jump)


def check(found, truth):
    """Assert derivatives of a floor point's radiance, without any bias allowed for."""
    largest = np.abs(truth["blocker.vertices"]).max()
    wrong = []
    for name, true in truth.items():
        mean, error = mean_and_error(found[name] / largest)
        assert error.max() < 0.1, (name, error)
        wrong.append(np.any(np.abs(mean - true / largest) > 4.5 * error + 1e-5))
    return not any(wrong)


@pytest.mark.parametrize(
    ("blocker", "boundary", "wrong"),
    [
        (QUADRANGLE, jd.WalkOnCaps(), False),
        (QUADRANGLE, jd.WalkOnCaps(), True),
        pytest.param(HALF_PLANE, jd.WalkOnCaps(steps=3, walks=2, reach=0.5), False, marks=pytest.mark.slow),
        pytest.param(QUADRANGLE, jd.WalkOnCaps(steps=1, walks=1, share=0.8, reach=1.5), False, marks=pytest.mark.slow),
    ],
)
def test_every_derivative_is_the_closed_form(monkeypatch, blocker, boundary, wrong):
    """Blocker, light (its outlines move on the sphere) and floor; wrong, and seen so, if caps are too small."""
    if wrong:
        exactly = walking.rim_over_area
        monkeypatch.setattr(walking, "rim_over_area", lambda radius: 1.3 * exactly(radius))
    blocker = sheet(blocker, 0.1)
    rows = estimates(point_scene(blocker), boundary, keys=48, spp=8 + wrong)[1]  # many keys: errors are known well
    assert check(rows, exact(blocker)[1]) != wrong


@pytest.mark.slow
def test_cube_shaped_light():
    """All its outlines are edges between two faces, and its other edges are none."""
    truth = cube_derivatives()
    mean, error, _ = of_cube(jd.WalkOnCaps(), keys=8, spp=16)
    scale = np.abs(truth).max()
    assert error.max() < 0.03 * scale, (error, truth)
    assert np.all(np.abs(mean - truth) < 4.5 * error), (mean, error, truth)


@pytest.mark.slow
def test_a_soft_shadow_moves_as_differences_say():
    """By quarters of the film, and as a whole."""
    check_shadow(jd.WalkOnCaps(), 2)


@pytest.mark.slow
def test_keys_in_a_batch():
    """`vmap` over keys gives what single keys give."""
    tracer = jd.PathTracer(2, jd.WalkOnCaps())
    one = jnp.stack([by_x(tracer, 4, False, key) for key in KEYS[:2]])
    both = jax.jit(jax.vmap(lambda key: by_x(tracer, 4, False, key)))(KEYS[:2])
    assert np.allclose(one, both, rtol=1e-3, atol=1e-3 * float(jnp.abs(one).max()))


def test_what_is_not_covered():
    for options in ({"steps": 0}, {"walks": 0}, {"share": 1.1}, {"share": 0.0}, {"reach": 4.0}):
        (name,) = options
        with pytest.raises(ValueError, match=f"WalkOnCaps: {name} must be"):
            jd.WalkOnCaps(**options)
    of = cube_scene()
    with pytest.raises(ValueError, match="WalkOnCaps: direct light only, but max_depth is 3"):
        jd.WalkOnCaps().prepare(one_term.context(of, (True, False), SETTINGS._replace(max_depth=3)), jax.random.key(0))
    floor = LIT_BOX.shapes["floor"].mesh
    smooth = jd.Scene(dict(LIT_BOX.shapes) | {"floor": jd.Shape(floor.smooth())}, LIT_BOX.camera)
    with pytest.raises(ValueError, match="WalkOnCaps covers no horizons of surfaces with interpolated normals"):
        jd.WalkOnCaps().prepare(one_term.context(smooth, (True, False, False), SETTINGS), jax.random.key(0))
