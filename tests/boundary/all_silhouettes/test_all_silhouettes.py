"""`AllSilhouettes`: exact derivatives of shadows, two bounces, how fast errors fall, what happens without room."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.all_silhouettes import estimator as estimator_module
from jaxdr.geometry.shapes import displaced_sphere, rectangle
from tests.gradients.floor_point import BOX, QUADRANGLE, check_derivatives, estimates, exact, flat, mean_and_error
from tests.gradients.floor_point import scene as point_scene
from tests.gradients.lit_box import check_refusals, check_shadow


def test_derivatives_are_the_closed_form():
    """A closed blocker's shadow, by every vertex of it and of the light, without any bias allowed for."""
    check_derivatives(BOX, jd.AllSilhouettes(8), tolerance=0.0)


@pytest.mark.parametrize("wrong", [None, "angle"])
def test_open_blockers_and_a_broken_density(monkeypatch, wrong):
    """Right for the four open edges of a quadrangle; wrong, and seen to be, where points are not as dense as said."""
    if wrong == "angle":
        evenly = estimator_module.on_edges

        def on_edges(*arguments):
            along, angle = evenly(*arguments)
            return along**1.1, angle

        monkeypatch.setattr(estimator_module, "on_edges", on_edges)
    truth = exact(flat(QUADRANGLE))[1]["blocker.vertices"]
    boundary = jd.AllSilhouettes(8 if wrong is None else 9)  # a program for each
    _, rows = estimates(point_scene(flat(QUADRANGLE)), boundary)
    mean, error = mean_and_error(rows["blocker.vertices"] / np.abs(truth).max())
    off = np.abs(mean - truth / np.abs(truth).max())
    assert error.max() < 0.01, error
    assert np.all(off < 4.5 * error) == (wrong is None), (off, error)


@pytest.mark.parametrize("depth", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_soft_shadow_moves_as_differences_say(depth):
    """By quarters of the film, and as a whole; at depth 3 also what the lit box sends to the floor."""
    check_shadow(jd.AllSilhouettes(12), depth)


BALL = displaced_sphere(2, radius=0.5, center=(0.0, 0.5, 1.2))
MIRROR = jd.Scene(
    {
        "ball": jd.Shape(BALL, jd.Diffuse(0.0)),
        "mirror": jd.Shape(rectangle(12.0, 12.0), jd.RoughConductor(alpha=0.3)),
    },
    jd.Perspective(jd.look_at((0, -3, 1.6), (0, -1, 0), (0, 0, 1)), 24.0, jd.Film(8, 8, jd.Box())),
    jd.ConstantEnvironment(1.0),
)


@cache
def derivatives(boundary, spp, keys):
    """Derivative images [keys, 8, 8] by a translation of the ball."""
    vertices = MIRROR.parameters()["ball.vertices"]
    tracer = jd.PathTracer(2, boundary)

    @jax.jit
    def derivative(key):
        def image(x):
            moved = MIRROR.replace({"ball.vertices": vertices + x * jnp.asarray([1.0, 0.0, 0.0])})
            return jd.render(moved, key, spp=spp, integrator=tracer).mean(-1)

        return jax.jvp(image, (0.0,), (1.0,))[1]

    return np.stack([derivative(key) for key in jax.random.split(jax.random.key(spp), keys)]).astype(float)


@pytest.mark.slow
def test_errors_fall_faster_than_those_of_random_points():
    """16 times the samples, more than 7 times less noise in a rough mirror; independent points have 4."""
    few, many = (derivatives(jd.AllSilhouettes(100), spp, 12) for spp in (2, 32))
    size = np.sqrt(np.mean(many.mean(0) ** 2))
    noise = [np.sqrt(images.var(0, ddof=1).mean()) / size for images in (few, many)]
    assert noise[0] < 0.3 and noise[0] > 7 * noise[1], noise
    other = derivatives(jd.LineSampling(chords=8.0), 32, 12)
    error = np.sqrt((other.var(0, ddof=1) + many.var(0, ddof=1)) / 12)
    assert np.mean((np.abs(other.mean(0) - many.mean(0)) / error) ** 2) < 1.6


@pytest.mark.slow
def test_without_room_silhouettes_are_thinned():
    """A warning says so, and the mean is the same."""
    with pytest.warns(UserWarning, match="silhouettes of .* exceed the capacity"):
        thinned = derivatives(jd.AllSilhouettes(10), 2, 64)
    whole = derivatives(jd.AllSilhouettes(100), 32, 12)
    error = np.sqrt(thinned.var(0, ddof=1) / len(thinned) + whole.var(0, ddof=1) / len(whole))
    z = (thinned.mean(0) - whole.mean(0)) / error
    assert np.abs(z).max() < 4.5 and np.mean(z**2) < 1.6, z


def test_what_is_not_covered():
    with pytest.raises(ValueError, match="AllSilhouettes: capacity must be at least 1"):
        jd.AllSilhouettes(0)
    check_refusals(jd.AllSilhouettes())
