"""Optimise a pose: find where a box stands and how it is turned, from one image, with Adam of optax."""

import jax
import jax.numpy as jnp
import optax

import jaxdr as jd

PIXELS, SAMPLES, STEPS = 48, 8, 80
TRUE, START = jnp.array([0.3, 0.2, 0.6]), jnp.array([-0.1, -0.1, 0.0])  # x, y (scene units), angle (radians)


def make_scene() -> jd.Scene:
    """A box at the origin on a floor, under a lamp and a faint sky."""
    box = jd.Shape(jd.shapes.box((0.9, 0.6, 0.5), center=(0.0, 0.0, 0.26)), jd.Diffuse((0.2, 0.5, 0.7)))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, -1, 4), (0, 0, 0), (0, 1, 0)))
    shapes = {"box": box, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0))}
    to_world = jd.look_at((0, -4, 3.5), (0, 0, 0.2), (0, 0, 1))
    camera = jd.Perspective(to_world, fov=32.0, film=jd.Film(PIXELS, PIXELS))
    return jd.Scene(shapes, camera, jd.ConstantEnvironment(0.2))


def main(steps: int = STEPS) -> jax.Array:
    """Prints the error as it falls; returns the pose that was found."""
    scene = make_scene()
    tracer = jd.PathTracer(max_depth=2)

    def image(pose, key, spp=SAMPLES):
        x, y, angle = pose
        placed = jd.move(scene, {"box.translate.x": x, "box.translate.y": y, "box.rotate.z": angle})
        return jd.render(placed, key, spp=spp, integrator=tracer)

    with jd.working("rendering the target"):
        target = image(TRUE, jax.random.key(0), spp=256)
    optimiser = optax.adam(optax.cosine_decay_schedule(0.04, steps, alpha=0.05))

    @jax.jit
    def step(pose, state, key):
        # A fresh key in every step: noise then averages out instead of being fitted.
        loss, gradient = jax.value_and_grad(lambda p: jd.losses.l2(image(p, key), target))(pose)
        updates, state = optimiser.update(gradient, state)
        return optax.apply_updates(pose, updates), state, loss

    pose, state = START, optimiser.init(START)
    with jd.working("compiling"):
        step(pose, state, jax.random.key(1))
    for i in range(steps):
        pose, state, loss = step(pose, state, jax.random.key(i + 1))
        if i % 20 == 0 or i == steps - 1:
            print(f"step {i:3d}  loss {loss:.5f}  error {jnp.abs(pose - TRUE).max():.4f}")
    return pose


if __name__ == "__main__":
    main()
