"""Albedo and light together: the colour of a ball and the radiance of a lamp, from one image.

Nothing moves, so there are no boundary terms: it compiles in seconds. The floor's colour is known. Without something
known a brighter lamp and a darker world would look the same.
"""

import jax
import jax.numpy as jnp
import optax

import jaxdr as jd

PIXELS, SAMPLES, STEPS = 48, 8, 150


def make_scene(albedo, radiance) -> jd.Scene:
    """A ball on a grey floor, under a square lamp."""
    ball = jd.Shape(jd.shapes.sphere(2, radius=0.6, center=(0.0, 0.0, 0.6)), jd.Diffuse(albedo))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((1, -2, 4), (0, 0, 0.5), (0, 1, 0)))
    shapes = {"ball": ball, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(radiance))}
    to_world = jd.look_at((0, -4, 2.5), (0, 0, 0.4), (0, 0, 1))
    return jd.Scene(shapes, jd.Perspective(to_world, fov=35.0, film=jd.Film(PIXELS, PIXELS)))


def main(steps: int = STEPS) -> dict[str, jax.Array]:
    """Returns what was found, by the names of the scene's parameters."""
    true, tracer = make_scene((0.7, 0.3, 0.1), (24.0, 20.0, 14.0)), jd.PathTracer(max_depth=3)
    target = jd.render(true, jax.random.key(0), spp=256, integrator=tracer)
    names = ["ball.bsdf.reflectance", "lamp.emitter.radiance"]
    scene = make_scene(0.5, 10.0)

    # What is optimised has no bounds; albedo in (0, 1) and radiance above zero are made from it.
    def values(latent):
        return {names[0]: jax.nn.sigmoid(latent[0]), names[1]: jnp.exp(latent[1])}

    def loss(latent, key):
        image = jd.render(scene.replace(values(latent)), key, spp=SAMPLES, integrator=tracer)
        return jd.losses.l2(image, target)

    optimiser = optax.adam(optax.cosine_decay_schedule(0.1, steps, alpha=0.02))

    @jax.jit
    def step(latent, state, key):
        updates, state = optimiser.update(jax.grad(loss)(latent, key), state)
        return optax.apply_updates(latent, updates), state

    latent = (jnp.zeros(3), jnp.full(3, jnp.log(10.0)))
    state = optimiser.init(latent)
    for i in range(steps):
        latent, state = step(latent, state, jax.random.key(i + 1))
    return values(latent)


if __name__ == "__main__":
    with jd.working("finding albedo and light"):
        found = main()
    for name, value in found.items():
        print(name, value)
