"""`derivative_terms` refuses and warns as `render` does: one table of calls for both."""

import inspect
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

KEY = jax.random.key(3)
TRACER = jd.PathTracer(1, primary="material")


def scene(pixel_filter=None) -> jd.Scene:
    """A board of squares under a lamp of two faces."""
    board = jd.Diffuse(jd.Checkerboard(0.2, 0.8, to_uv=np.eye(3)))
    lamp = jd.shapes.rectangle(0.5, 0.5, (0.5, 0.3, 3.0))
    shapes = {
        "board": jd.Shape(jd.shapes.rectangle(2.0, 2.0), board),
        "lamp": jd.Shape(lamp, jd.TwoSided(jd.Diffuse(0.0)), jd.AreaEmitter(20.0)),
    }
    film = jd.Film(8, 8, pixel_filter or jd.Gaussian())
    camera = jd.Perspective(jd.look_at((2, -3, 3), (0, 0, 0), (0, 0, 1)), 40.0, film)
    return jd.Scene(shapes, camera, lights={"point": jd.PointLight((1.0, 1.0, 2.0), 1.0)})


def rendered(of, integrator):
    return jd.render(of, KEY, 1, integrator)


def summed(of, integrator):
    return sum(jd.derivative_terms(of, KEY, 1, integrator).values())


BOTH = pytest.mark.parametrize("image", [rendered, summed])


def differentiate(image, name, of=None, integrator=TRACER, jit=False):
    """Trace the derivative by one parameter, without compiling it."""
    of = of or scene()
    value = of.parameters()[name]

    def moved(t):
        return image(of.replace({name: value + t}), integrator)

    moved = jax.jit(moved) if jit else moved
    return jax.eval_shape(lambda t: jax.jvp(moved, (t,), (jnp.ones_like(t),))[1], jnp.zeros(()))


@BOTH
@pytest.mark.parametrize("jit", [False, True])
def test_maps_that_move_are_refused(image, jit):
    with pytest.raises(ValueError, match=r"board\.bsdf\.reflectance jumps inside faces .* no derivative by to_uv"):
        differentiate(image, "board.bsdf.reflectance.to_uv", jit=jit)
    differentiate(image, "board.bsdf.reflectance.color0", jit=jit)


@BOTH
def test_without_boundary_terms_no_map_is_refused(image):
    differentiate(image, "board.bsdf.reflectance.to_uv", integrator=jd.PathTracer(1, None))


def test_maps_that_move_are_refused_in_reverse():
    of = scene()
    name = "board.bsdf.reflectance.to_uv"
    with pytest.raises(ValueError, match="no derivative by to_uv"):
        jax.grad(lambda v: summed(of.replace({name: v}), TRACER).sum())(of.parameters()[name])


@BOTH
def test_scenes_that_the_integrator_does_not_take_are_refused(image):
    with pytest.raises(ValueError, match="a Box has no derivative of finite variance; use Gaussian"):
        image(scene(jd.Box()), jd.PathTracer(1, None, primary="material"))


@pytest.mark.parametrize("function", [jd.render, jd.derivative_terms])
@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"spp": 0}, "spp must be a positive whole number of samples per pixel, got 0"),
        ({"spp": -3}, "got -3"),
    ],
)
def test_wrong_arguments(function, arguments, message):
    plain = inspect.unwrap(function)  # without the type checker of the tests
    with pytest.raises(ValueError, match=rf"{plain.__name__}: .*{message}"):
        plain(**({"scene": scene(), "key": KEY, "spp": 1} | arguments))


@BOTH
def test_estimators_that_fail_are_warned_of(image):
    with pytest.warns(jd.EstimatorWarning, match="WarpedArea fails by nature here"):
        tracer = jd.PathTracer(2, jd.WarpedArea(samples=2), primary="material")
        differentiate(image, "board.vertices", integrator=tracer)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        differentiate(image, "board.vertices")


MOVES = {"board.vertices": "board", "camera.to_world": "camera", "point.position": "point"}
ONLY_THE_LAMP = jd.Moving((False, True), False)


def summed_for(moving):
    return lambda of, integrator: sum(jd.derivative_terms(of, KEY, 1, integrator, moving).values())


@pytest.mark.parametrize("moving", [ONLY_THE_LAMP, ONLY_THE_LAMP._replace(lights=(False,))])
@pytest.mark.parametrize("name", MOVES)
def test_what_moves_against_the_word_of_moving_is_refused(name, moving):
    """Its terms would be left out of the sum."""
    with pytest.raises(ValueError, match=f"derivative_terms: {MOVES[name]} moves, and moving says that it stays"):
        differentiate(summed_for(moving), name)


def test_what_moving_names_may_move():
    differentiate(summed_for(ONLY_THE_LAMP), "lamp.vertices")
    differentiate(summed_for(ONLY_THE_LAMP), "board.vertices", integrator=jd.PathTracer(1, None))


@pytest.mark.parametrize("shapes, lights", [((True,), ()), ((True, True), (True, True))])
def test_moving_of_another_scene_is_refused(shapes, lights):
    with pytest.raises(ValueError, match=r"derivative_terms: moving has .* flags"):
        jd.derivative_terms(scene(), KEY, 1, TRACER, jd.Moving(shapes, False, lights))


def test_only_what_is_differentiated_gets_a_tangent():
    """The look at the derivatives must not make zeros of what is not differentiated: they would cost a program."""
    of = scene()

    def size(*names):
        def terms(t):
            return summed(of.replace({name: of.parameters()[name] + t for name in names}), TRACER)

        return str(jax.make_jaxpr(lambda t: jax.jvp(terms, (t,), (t,)))(1.0)).count("=")

    color = "board.bsdf.reflectance.color0"
    assert size(color) < 0.97 * size(color, "board.vertices")
