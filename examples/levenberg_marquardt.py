"""Levenberg-Marquardt with optimistix: where a ball and a lamp are, from one image, in a dozen steps.

For a few numbers this needs far fewer steps than Adam. `jaxdr optimize` does it with more care: damping, blurred
images, resuming (docs/recovery.md).
"""

import jax
import jax.numpy as jnp
import optimistix

import jaxdr as jd

PIXELS, SAMPLES = 32, 32
TRUE, START = jnp.array([0.2, 0.9, 1.5]), jnp.array([0.0, 0.7, 1.0])  # x and z of the ball, x of the lamp


def make_scene() -> jd.Scene:
    """A ball and a lamp at the origin, a floor below."""
    ball = jd.Shape(jd.shapes.sphere(2, radius=0.4), jd.Diffuse(0.7))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    down = jd.shapes.transformed(jd.shapes.rectangle(1.5, 1.5), jd.look_at((0, 0, 0), (0, 0, -1), (0, 1, 0)))
    shapes = {"ball": ball, "floor": floor, "lamp": jd.Shape(down, jd.Diffuse(0.0), jd.AreaEmitter(15.0))}
    to_world = jd.look_at((0, -5, 3.5), (0, 0, 0.4), (0, 0, 1))
    return jd.Scene(shapes, jd.Perspective(to_world, fov=36.0, film=jd.Film(PIXELS, PIXELS)))


def main(steps: int = 12) -> jax.Array:
    """Returns the three numbers that were found."""
    scene = make_scene()
    still, tracer = scene.parameters(), jd.PathTracer(max_depth=2)

    def image(numbers, key, spp=SAMPLES):
        x, z, lamp_x = numbers
        ball = still["ball.vertices"] + jnp.array([x, 0.0, z])
        lamp = still["lamp.vertices"] + jnp.array([lamp_x, 0.0, 4.0])
        return jd.render(scene.replace({"ball.vertices": ball, "lamp.vertices": lamp}), key, spp, tracer)

    target = image(TRUE, jax.random.key(0), 256)

    def residuals(numbers, key):
        # The same key in every step: the residuals are one fixed function, which the solver can trust.
        return (image(numbers, key) - target).ravel()

    solver = optimistix.LevenbergMarquardt(rtol=1e-3, atol=1e-3)
    options = {"jac": "fwd"}  # three inputs, thousands of outputs: forward mode
    found = optimistix.least_squares(residuals, solver, START, jax.random.key(1), options, max_steps=steps, throw=False)
    return found.value


if __name__ == "__main__":
    with jd.working("compiling and solving"):
        found = main()
    print("found", found, "true", TRUE)
