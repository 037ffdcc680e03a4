"""Radiance in value alone: that of the paths with a record, whatever blocks they are worked on in."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, sphere
from jaxdr.scene.packed import pack
from jaxdr.transport import radiance
from jaxdr.transport.near_field import footprint
from jaxdr.transport.path import Lobe, trace_paths
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples

KEY = jax.random.key(50)


@cache
def scene() -> jd.Scene:
    """Two bodies under a lamp and a dim sky: many paths leave at once, some go on for long."""
    shapes = {
        "floor": jd.Shape(rectangle(4.0, 4.0), jd.TwoSided(jd.Diffuse([0.7, 0.5, 0.3]))),
        "matt": jd.Shape(sphere(2, 0.6, (-0.8, 0.0, 0.6)), jd.Diffuse(0.8)),
        "glass": jd.Shape(sphere(2, 0.6, (0.8, 0.0, 0.7)), jd.Dielectric()),
        "lamp": jd.Shape(rectangle(1.0, 1.0, (0.0, 0.0, 3.0)), jd.TwoSided(jd.Diffuse(0.5)), jd.AreaEmitter(6.0)),
    }
    camera = jd.Perspective(jd.look_at([0, -6, 2.5], [0, 0, 0.5], [0, 0, 1]), 40.0, jd.Film(24, 16, jd.Box()))
    return jd.Scene(shapes, camera, environment=jd.ConstantEnvironment(0.2))


def both(key, depth, mis=True, samples=4):
    """(radiance in value alone, radiance of the record) of all pixels."""
    return traced(scene(), key, depth, mis, samples)


@partial(jax.jit, static_argnames=("depth", "mis", "samples"))
def traced(scene, key, depth, mis, samples):
    packed, settings = pack(scene), PathSettings(depth, mis, "auto")
    primary = primary_samples(packed, jnp.arange(samples), key, "auto", Form.FIXED)
    arguments = packed, primary.first, primary.direction, primary.u, jax.random.fold_in(key, 1), settings
    return radiance.arriving_radiance(*arguments), trace_paths(*arguments).radiance


@pytest.mark.parametrize("depth, mis", [(1, True), (2, True), (2, False)])
def test_one_bounce_is_the_same_to_rounding(depth, mis):
    """The first bounce's random numbers are the caller's."""
    quick, recorded = both(KEY, depth, mis)
    np.testing.assert_allclose(quick, recorded, rtol=2e-5, atol=1e-5)


@pytest.mark.parametrize("mis", [True, False])
def test_more_bounces_agree_in_the_mean(mis):
    rows = []
    for i in range(12):
        quick, recorded = both(jax.random.fold_in(KEY, i), 6, mis, samples=32)
        rows.append((quick - recorded).mean(0))
    mean, error = np.mean(rows, 0), np.std(rows, 0, ddof=1) / np.sqrt(len(rows))
    assert np.all(np.abs(mean) < 4.5 * error)
    assert np.all(error < 0.01 * np.mean(recorded, 0))


def test_blocks_do_not_matter(monkeypatch):
    expected = both(KEY, 6)[0]
    monkeypatch.setattr(radiance, "CPU_BLOCK", 100)
    traced.clear_cache()
    np.testing.assert_allclose(both(KEY, 6)[0], expected, rtol=1e-5, atol=1e-6)
    traced.clear_cache()


def test_remaining_bounces_and_streams():
    """Every path scatters as often as it may; those of one stream see the same random numbers throughout."""
    packed, settings = pack(scene()), PathSettings(5, True, "auto")
    primary = primary_samples(packed, jnp.arange(2), KEY, "auto", Form.FIXED)
    count = len(primary.direction)

    def gathered(bounces, copies=1, stream=None):
        """Without what the points themselves emit."""
        first, wi, u = jax.tree.map(
            lambda x: jnp.concatenate([x] * copies), (primary.first, -primary.direction, primary.u)
        )
        stream = jnp.arange(len(u)) if stream is None else stream
        asked = radiance.request(first, wi, u, bounces, stream.astype(jnp.uint32), emission=0.0)
        return np.asarray(radiance.radiance(packed, asked, KEY, settings).total)

    whole, once = gathered(4), gathered(1)
    remaining = jnp.arange(count) % 3
    some = gathered(remaining)
    assert not some[remaining == 0].any()
    np.testing.assert_allclose(some[remaining == 1], once[remaining == 1], rtol=1e-5, atol=1e-6)
    assert np.all(whole >= once - 1e-5) and whole.sum() > 1.1 * once.sum()
    pairs = gathered(4, copies=2, stream=jnp.tile(jnp.arange(count), 2))
    np.testing.assert_allclose(pairs[:count], pairs[count:], rtol=1e-5, atol=1e-6)
    alone = gathered(4, copies=2)
    assert np.abs(alone[:count] - alone[count:]).max() > 0.1


def test_derivatives_do_not_pass():
    """It is of values alone: derivatives through it are zero, in both modes, not an error."""
    packed, settings = pack(scene()), PathSettings(4, True, "auto")
    primary = primary_samples(packed, jnp.arange(1), KEY, "auto", Form.FIXED)

    def total(brightness):
        dimmed = primary.first._replace(position=brightness * primary.first.position)
        return radiance.arriving_radiance(packed, dimmed, primary.direction, primary.u, KEY, settings).sum()

    assert jax.jit(jax.grad(total))(1.0) == 0.0
    assert jax.jit(lambda x: jax.jvp(total, (x,), (1.0,))[1])(1.0) == 0.0


@cache
def matt_scene() -> jd.Scene:
    """The same with a matt ball in place of the glass one."""
    of = scene()
    return jd.Scene(dict(of.shapes) | {"glass": of.shapes["matt"]}, of.camera, environment=of.environment)


@jax.jit
def lobes(of, key):
    """Means over pixels: from BSDF samples, and from directions that are uniform over the sphere."""
    packed, settings = pack(of), PathSettings(4, True, "auto")
    primary = primary_samples(packed, jnp.arange(64), key, "auto", Form.FIXED)
    stream = jnp.arange(len(primary.u), dtype=jnp.uint32)
    direction = jax.random.normal(jax.random.fold_in(key, 2), primary.direction.shape)
    direction /= jnp.linalg.norm(direction, axis=-1, keepdims=True)
    half = stream % 2 == 0  # the others have none
    means = []
    for given in (None, Lobe(direction, jnp.where(half, 0.25 / jnp.pi, 0.0))):
        asked = radiance.request(primary.first, -primary.direction, primary.u, 3, stream)._replace(given=given)
        means.append(radiance.radiance(packed, asked, jax.random.fold_in(key, 1), settings).total)
    return means[0].mean(0), means[1].mean(0), jnp.abs(jnp.where(half[:, None], 0.0, means[1] - means[0])).max()


def test_given_directions_are_unbiased():
    rows = [jax.device_get(lobes(matt_scene(), jax.random.fold_in(KEY, i))) for i in range(12)]
    difference = np.array([two - one for one, two, _ in rows])
    error = difference.std(0, ddof=1) / np.sqrt(len(rows))
    assert np.all(error < 0.03 * rows[0][0]) and np.any(difference != 0)
    assert np.all(np.abs(difference.mean(0)) < 4.5 * error)
    assert max(rest for *_, rest in rows) < 1e-4  # without a density the BSDF's are taken


@partial(jax.jit, static_argnames="depth")
def shares(of, key, depth):
    """What is in material form, by requests and by paths with a record, of all paths."""
    film = jd.Film(24, 16, jd.Gaussian(2.0))
    of = jd.Scene(of.shapes, jd.Perspective(of.camera.to_world, 40.0, film), environment=of.environment)
    packed, settings = pack(of), PathSettings(depth, True, "auto")
    primary = primary_samples(packed, jnp.arange(16), key, "auto", Form.NEAR)
    first, stream = primary.first, jnp.arange(len(primary.u), dtype=jnp.uint32)
    seen = footprint(primary.near.camera, first.position, first.normal)
    key = jax.random.fold_in(key, 1)
    asked = radiance.request(first, -primary.direction, primary.u, depth - 1, stream)._replace(seen=seen)
    answers = radiance.radiance(packed, asked, key, settings)
    near = trace_paths(packed, first, primary.direction, primary.u, key, settings, primary.near).near
    return answers, near.light * near.light_share[:, None] + near.beyond * near.beyond_share[:, None]


def test_share_in_material_form():
    """Of what a pixel sees in footprints: in the mean that of the paths with a record, and a part of the whole."""
    rows = []
    for i in range(12):
        answers, recorded = jax.device_get(shares(matt_scene(), jax.random.fold_in(KEY, i), 4))
        assert np.all(answers.near <= answers.total * (1 + 1e-5) + 1e-6)
        rows.append((answers.near.mean(0), recorded.mean(0)))
    difference = np.array([one - two for one, two in rows])
    error = difference.std(0, ddof=1) / np.sqrt(len(rows))
    assert np.all(rows[0][1] > 0) and np.all(error < 0.05 * rows[0][1])
    assert np.all(np.abs(difference.mean(0)) < 4.5 * error)


def test_lists_are_answered_as_if_alone():
    """Whatever else is asked for: with footprints, with given directions, without either."""
    packed, settings = pack(matt_scene()), PathSettings(4, True, "auto")
    primary = primary_samples(packed, jnp.arange(2), KEY, "auto", Form.FIXED)
    first, wi, u = primary.first, -primary.direction, primary.u
    seen = footprint(primary.view, first.position, first.normal)
    given = Lobe(wi, jnp.full(len(u), 0.5))
    lists = []
    for number, options in enumerate([{}, {"seen": seen}, {"given": given}]):
        stream = jnp.arange(len(u), dtype=jnp.uint32) + 10_000 * number
        asked = radiance.request(first, wi, u, 3 - number, stream, emission=1.0 - 0.5 * number)
        lists.append(asked._replace(**options))
    together = radiance.split(radiance.radiance(packed, radiance.joined(lists), KEY, settings), lists)
    for asked, found in zip(lists, together, strict=True):
        alone = radiance.radiance(packed, asked, KEY, settings)
        assert found.total.shape == asked.wi.shape and float(alone.total.sum()) > 0
        np.testing.assert_allclose(found.total, alone.total, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(found.near, alone.near, rtol=1e-5, atol=1e-5)
    assert not np.any(together[0].near) and np.any(together[1].near)
