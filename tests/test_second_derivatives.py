"""An image has first derivatives only. Whoever asks for second ones is told so, whatever they are by."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

KEY = jax.random.key(0)
TRACER = jd.PathTracer(1, boundary=None)


@pytest.fixture(scope="module")
def brightness():
    """Image as a function of a board's height and the radiance of the sky."""
    camera = jd.Perspective(jd.look_at((0, 0, 4), (0, 0, 0), (0, 1, 0)), 40.0, jd.Film(2, 2))
    scene = jd.Scene({"board": jd.Shape(jd.shapes.rectangle())}, camera, jd.ConstantEnvironment(2.0))

    def of(height, radiance, renders=jd.render):
        moved = scene.parameters()["board.vertices"] + jnp.stack([0.0, 0.0, height])
        changed = scene.replace({"board.vertices": moved, "environment.radiance": radiance * jnp.ones(3)})
        return renders(changed, KEY, 1, TRACER)

    return of


def terms(scene, key, spp, integrator):
    return sum(jd.derivative_terms(scene, key, spp, integrator).values())


def alpha(scene, key, spp, integrator):
    return jd.render_aovs(scene, key, spp, ["alpha"])["alpha"]


INNER = {"grad": jax.grad, "jacfwd": jax.jacfwd, "jit": lambda f: jax.jit(jax.grad(f))}


@pytest.mark.parametrize("inner", INNER)
@pytest.mark.parametrize("outer", [jax.jacfwd, jax.grad])
@pytest.mark.parametrize("renders", [jd.render, terms, alpha])
def test_mixed_ones_raise(brightness, renders, outer, inner):
    """Also where the first derivative is by one parameter and the second by another."""
    for first, second in ((0, 1), (1, 0)):
        if renders is alpha and first == 1:
            continue  # coverage does not depend on radiance: there is no first derivative

        def slope(x, first=first, second=second):
            at = [0.0, 2.0]
            at[second] = x
            return INNER[inner](lambda y: brightness(*at[:first], y, *at[first + 1 :], renders).sum())(at[first])

        with pytest.raises(NotImplementedError, match="first derivatives only"):
            outer(slope)(1.0)


def test_an_unrolled_step_raises(brightness):
    def after(radiance):
        step = jax.grad(lambda height: brightness(height, radiance).sum())(0.0)
        return brightness(-0.1 * step, radiance).sum()

    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.grad(after)(2.0)


def test_detached_gradients_have_none(brightness):
    """What a gradient depends on has to be detached before it is taken; detached afterwards it raises as well."""

    def value(radiance):
        found, slope = jax.value_and_grad(lambda height: brightness(height, radiance).sum())(0.0)
        return found + jax.lax.stop_gradient(slope)

    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.grad(value)(2.0)

    def beside(radiance):
        height = jax.grad(lambda height: brightness(height, jax.lax.stop_gradient(radiance)).sum())(0.0)
        return brightness(jax.lax.stop_gradient(height), radiance).sum()

    expected = jax.grad(lambda radiance: brightness(0.0, radiance).sum())(2.0)
    np.testing.assert_allclose(jax.grad(beside)(2.0), expected, rtol=1e-5)


def test_losses_may_be_curved(brightness):
    """Only the image has first derivatives; what becomes of them may be differentiated: a Gauss-Newton product."""

    def product(weight):
        image, pull = jax.vjp(lambda radiance: brightness(0.0, radiance), 2.0)
        return pull(weight * jax.lax.stop_gradient(image))[0]

    slope = jax.grad(product)(1.0)
    assert np.isfinite(slope) and slope > 0
