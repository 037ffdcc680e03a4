"""First gradient: how an image changes as a ball moves to the right, its silhouette and its shadow included."""

import jax
import jax.numpy as jnp

import jaxdr as jd

PIXELS, SAMPLES = 64, 32


def make_scene() -> jd.Scene:
    """A ball above a floor, under a square lamp."""
    ball = jd.Shape(jd.shapes.sphere(2, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse((0.8, 0.5, 0.3)))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    shapes = {"ball": ball, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0))}
    to_world = jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1))
    return jd.Scene(shapes, jd.Perspective(to_world, fov=35.0, film=jd.Film(PIXELS, PIXELS)))


def main() -> jax.Array:
    """Writes image.png and derivative.png (red: gets brighter, blue: gets darker); returns the derivative image."""
    scene = make_scene()
    vertices = scene.parameters()["ball.vertices"]
    tracer = jd.PathTracer(max_depth=2)  # direct light

    def image(x, key):
        """The image [H, W, 3] with the ball moved by x along the x axis."""
        moved = scene.replace({"ball.vertices": vertices + x * jnp.array([1.0, 0.0, 0.0])})
        return jd.render(moved, key, spp=SAMPLES, integrator=tracer)

    @jax.jit
    def image_and_derivative(key):
        # One input, many outputs: forward mode. For one loss and many inputs take jax.grad.
        return jax.jvp(lambda x: image(x, key), (0.0,), (1.0,))

    picture, derivative = image_and_derivative(jax.random.key(0))
    jd.write_image("image.png", picture)
    grey = derivative.mean(-1)
    red, blue = jnp.maximum(grey, 0), jnp.maximum(-grey, 0)
    jd.write_image("derivative.png", jnp.stack([red, jnp.zeros_like(grey), blue], -1))
    return derivative


if __name__ == "__main__":
    with jd.working("compiling and rendering"):
        derivative = main()
    print("mean absolute derivative:", float(jnp.abs(derivative).mean()))
