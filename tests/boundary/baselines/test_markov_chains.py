"""`MarkovChains`: walks along silhouettes, what chains keep, exact derivatives with short chains, two bounces."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments import one_term
from jaxdr.boundary.baselines.markov_chains import metropolis
from jaxdr.boundary.baselines.markov_chains.estimator import space_of
from jaxdr.boundary.baselines.markov_chains.metropolis import Steps, run_chains
from jaxdr.boundary.baselines.markov_chains.segments import fresh_lines, states_of
from jaxdr.boundary.baselines.markov_chains.walks import Seen, edge_rings, walk
from jaxdr.boundary.guided_edges.edge_lunes import LunePoints, edge_lunes, passing
from jaxdr.geometry.shapes import sphere
from jaxdr.scene.packed import pack
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import uniform
from tests.boundary.guided_edges.test_guided_edges import BLOCKER, derivatives
from tests.gradients.floor_patch import exact
from tests.gradients.floor_patch import scene as patch_scene
from tests.gradients.floor_point import mean_and_error
from tests.gradients.lit_box import KEYS, by_x, check_shadow
from tests.gradients.lit_box import SCENE as LIT_BOX

SETTINGS = PathSettings(2, True, "auto")
WALKERS = 1 << 15
# Two triangles with a vertex in common, where four silhouettes meet, and an edge of three faces.
BOW_TIE = jd.Mesh(
    [[0, 0, 0], [1, 0, 0.2], [1, 0.7, 0], [-1, 0, 0.1], [-0.4, -0.8, 0], [0.5, 1, 1.0]],
    [[0, 1, 2], [0, 3, 4], [2, 1, 5], [1, 2, 4]],
)


@partial(jax.jit, static_argnums=1)
def walked(of, infinite, key):
    """Walkers that start evenly over the silhouettes seen from a place, their ends, and where two ways back lead."""
    packed = pack(of)
    lunes = edge_lunes(packed, (True,) * len(of.shapes))
    rings = edge_rings(lunes)
    seen = Seen(jnp.broadcast_to(jnp.asarray([0.3, -4.0, 3.0]), (WALKERS, 3)), jnp.full(WALKERS, infinite))
    every = jnp.arange(lunes.edge.shape[0])
    here = jax.tree.map(lambda table: table[: every.shape[0]], seen)
    silhouette = passing(lunes, every, here.towards(lunes.start)).silhouette & (lunes.density > 0)
    whole = jnp.where(silhouette, jnp.linalg.norm(lunes.side, axis=1), 0.0)
    u = uniform(key, (5, WALKERS))
    cdf = jnp.cumsum(whole) / whole.sum()
    row = jnp.minimum(jnp.searchsorted(cdf, u[0], side="right"), every.shape[0] - 1)
    start, sense = LunePoints(row, u[1]), u[2] < 0.5
    length = 2.0 * whole.sum() / silhouette.sum() * u[3] * jnp.where(u[4] < 0.5, 1.0, -1.0)
    end, arrived = walk(lunes, rings, start, seen, length, sense)
    back = [walk(lunes, rings, end, seen, sign * length, ~sense) for sign in (1.0, -1.0)]
    return whole, start, end, arrived, back


@pytest.mark.slow
@pytest.mark.parametrize("infinite", [False, True])
@pytest.mark.parametrize("mesh", [sphere(1), sphere(2), BOW_TIE], ids=["coarse", "fine", "bow tie"])
def test_walks_are_symmetric(mesh, infinite):
    """They stay on silhouettes and keep what is spread evenly over them; a way back is as long as the way there."""
    of = jd.Scene({"mesh": jd.Shape(mesh)}, LIT_BOX.camera)
    whole, start, end, arrived, back = jax.device_get(walked(of, infinite, jax.random.key(3)))
    assert arrived.mean() > 0.99 and np.all(whole[end.row[arrived]] > 0)
    moved = (end.row != start.row)[arrived]
    assert 0.3 < moved.mean() < 0.95
    returns = np.zeros(WALKERS, bool)
    for point, there in back:
        returns |= there & (point.row == start.row) & (np.abs(point.along - start.along) < 1e-3)
    assert returns[arrived].mean() > 0.999
    lost = ~arrived
    expected = whole / whole.sum() * WALKERS
    expected = expected - np.bincount(start.row[lost], minlength=len(whole))  # those stay where they are
    number = np.bincount(end.row[arrived], minlength=len(whole))
    z = (number - expected)[whole > 0] / np.sqrt(expected[whole > 0])
    assert np.abs(z).max() < 4.5, z
    assert abs(end.along[arrived].mean() - 0.5) < 4.5 * 12**-0.5 / WALKERS**0.5


@partial(jax.jit, static_argnums=(0, 1))
def masses(steps, depth, key):
    """Light past the thirds of every edge, three times: by fresh segments, by the last states of chains, by visits."""
    settings = SETTINGS._replace(max_depth=depth)
    context = one_term.context(LIT_BOX, (True, False, False), settings)
    boundary = jd.MarkovChains()
    space = space_of(context, boundary.prepare(context, jax.random.key(0)))
    count = 3 * space.lunes.edge.shape[0]

    def binned(point, value):
        number = 3 * point.row + jnp.clip(jnp.floor(3 * point.along), 0, 2).astype(jnp.int32)
        return jnp.zeros(count).at[number].add(value)

    key_fresh, key_chains = jax.random.split(key)
    u = uniform(key_fresh, (steps.seeds, 4))
    fresh = states_of(space, fresh_lines(space, u))
    one = binned(fresh.point, jnp.where(fresh.density > 0, fresh.magnitude / fresh.density, 0.0) / steps.seeds)
    chains = run_chains(space, steps, key_chains)
    two = binned(chains.last.point, chains.total / steps.chains)
    visits = jax.tree.map(lambda table: table.reshape(-1, *table.shape[2:]), chains.visits)
    light = states_of(space, visits_lines(visits)).magnitude
    return jnp.stack([one, two, binned(visits.point, visits.weight * light)]), chains.accepted.mean()


def visits_lines(visits):
    """The visits as lines, wherever they end."""
    row = visits.point.row
    return metropolis.Lines(visits.point, visits.towards, jnp.full_like(row, metropolis.ANY), jnp.full(row.shape, True))


def broken(monkeypatch, wrong):
    """Make walks end a little too near to one end of edges, or leave out that they keep areas and not angles."""
    if wrong == "walk":
        exactly = metropolis.walk

        def uneven(*arguments):
            point, arrived = exactly(*arguments)
            return point._replace(along=point.along**1.3), arrived

        monkeypatch.setattr(metropolis, "walk", uneven)
    if wrong == "spread":
        exactly_states = metropolis.states_of
        monkeypatch.setattr(
            metropolis,
            "states_of",
            lambda *a: exactly_states(*a)._replace(spread=jnp.ones_like(exactly_states(*a).spread)),
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("large", "depth", "wrong"),
    [(0.0, 2, None), (0.3, 2, None), (0.3, 3, None), (0.0, 2, "walk"), (0.0, 2, "spread")],
)
def test_chains_keep_their_density(monkeypatch, large, depth, wrong):
    """By parts of edges, after twelve steps, chains have as much light as fresh segments; not so if a step is wrong."""
    broken(monkeypatch, wrong)
    steps = Steps(4096 + len(wrong or ""), 12, 1 << 15, large)  # a program for each
    rows, accepted = zip(*(jax.device_get(masses(steps, depth, key)) for key in KEYS), strict=True)
    rows = np.stack(rows).astype(float)
    mean, error = mean_and_error(rows)
    scale = mean[0].max()
    counts = mean[0] > 0.03 * scale
    assert counts.sum() > 8 and np.all(error[:, counts] < 0.1 * scale)
    assert 0.2 < np.mean(accepted) < 0.95
    good = []
    for k in (1, 2):
        off = np.abs(mean[k] - mean[0]) / np.hypot(error[k], error[0]).clip(1e-9 * scale)
        whole = (rows[:, k] - rows[:, 0]).sum(1)
        assert abs(whole.mean()) < 4.5 * whole.std(ddof=1) / len(KEYS) ** 0.5 or wrong
        good.append(off[counts].max() < 4.5)
    assert np.all(good) == (wrong is None), (mean, error)


@pytest.mark.parametrize(
    ("boundary", "wrong"),
    [
        (jd.MarkovChains(), False),
        pytest.param(jd.MarkovChains(length=1), False, marks=pytest.mark.slow),
        pytest.param(jd.MarkovChains(length=8, large=0.0), False, marks=pytest.mark.slow),
        pytest.param(jd.MarkovChains(2.0, length=64, seeds=0.4), False, marks=pytest.mark.slow),
        (jd.MarkovChains(length=16), True),
    ],
    ids=["default", "one step", "no large step", "few seeds", "wrong density"],
)
def test_derivatives_are_the_closed_form(monkeypatch, boundary, wrong):
    """Every vertex of an open blocker, with chains of any length; wrong, and seen so, if the seeds' density is off."""
    if wrong:
        exactly = metropolis.states_of

        def states(*arguments):
            found = exactly(*arguments)
            return found._replace(density=1.1 * found.density)

        monkeypatch.setattr(metropolis, "states_of", states)
    truth = exact(BLOCKER)
    scale = np.abs(truth).max()
    keys = jax.random.split(jax.random.key(1), 12)
    mean, error = mean_and_error(np.asarray(derivatives(patch_scene(BLOCKER), boundary, 1 << 15, keys), float) / scale)
    off = np.abs(mean - truth / scale)
    assert error.max() < 0.03, error
    assert np.all(off < 4.5 * error + 1e-6) != wrong, (off, error)


@pytest.mark.slow
@pytest.mark.parametrize("depth", [2, 3])
def test_a_soft_shadow_moves_as_differences_say(depth):
    """By quarters of the film, and as a whole; at depth 3 also what the lit box sends to the floor."""
    check_shadow(jd.MarkovChains(4.0), depth)


@pytest.mark.slow
def test_keys_in_a_batch():
    """`vmap` over keys gives what single keys give."""
    tracer = jd.PathTracer(2, jd.MarkovChains(length=4))
    one = jnp.stack([by_x(tracer, 4, False, key) for key in KEYS[:2]])
    both = jax.jit(jax.vmap(lambda key: by_x(tracer, 4, False, key)))(KEYS[:2])
    assert np.allclose(one, both, rtol=1e-3, atol=1e-3 * float(jnp.abs(one).max()))


def test_what_is_not_covered():
    for options, words in (({"samples": 0.0}, "samples"), ({"length": 0}, "length"), ({"large": 1.5}, "probability")):
        with pytest.raises(ValueError, match=f"MarkovChains: .*{words}"):
            jd.MarkovChains(**options)
    camera = jd.Orthographic(LIT_BOX.camera.to_world, film=LIT_BOX.camera.film)
    floor = LIT_BOX.shapes["floor"].mesh
    for bsdf, seen, words in (
        (jd.Conductor(), LIT_BOX.camera, "no visibility changes over mirrors"),
        (jd.RoughDielectric(), LIT_BOX.camera, "rough glass"),
        (jd.Diffuse(), camera, "no Orthographic camera"),
    ):
        of = jd.Scene(dict(LIT_BOX.shapes) | {"floor": jd.Shape(floor, bsdf)}, seen)
        with pytest.raises(ValueError, match=f"MarkovChains covers .*{words}"):
            jd.MarkovChains().prepare(one_term.context(of, (True, False, False), SETTINGS), jax.random.key(0))
