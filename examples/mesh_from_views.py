"""A mesh from rendered views: a sphere becomes a pawn, with `LargeSteps` and Adam for meshes (configs/quickstart)."""

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxdr as jd

PIXELS, SAMPLES, STEPS, VIEWS = 48, 8, 100, 6


def make_scene(mesh: jd.Mesh) -> jd.Scene:
    """A figure under a lamp and a sky."""
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.5, 1.5), jd.look_at((2, -1, 3), (0, 0, 0), (0, 1, 0)))
    shapes = {"figure": jd.Shape(mesh), "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(8.0))}
    camera = jd.Perspective(np.eye(4), fov=28.0, film=jd.Film(PIXELS, PIXELS))
    return jd.Scene(shapes, camera, jd.ConstantEnvironment(0.4))


def main(steps: int = STEPS) -> tuple[float, float]:
    """Writes figure.glb; returns the Chamfer distance to the pawn before and after."""
    pawn = jd.shapes.centred(jd.shapes.pawn(48), 1.1)
    sphere = jd.shapes.sphere(3, radius=0.35)
    angles = 2 * np.pi * np.arange(VIEWS) / VIEWS
    eyes = [(3.2 * np.cos(a), 3.2 * np.sin(a), 1.5 * (-1) ** i) for i, a in enumerate(angles)]
    poses = jnp.array([jd.look_at(eye, (0, 0, 0), (0, 0, 1)) for eye in eyes], jnp.float32)
    tracer = jd.PathTracer(max_depth=2)

    def image(scene, pose, key, spp):
        return jd.render(scene.replace({"camera.to_world": pose}), key, spp, tracer)

    draw = jax.jit(image, static_argnums=3)
    targets = jnp.stack([draw(make_scene(pawn), pose, jax.random.key(0), 128) for pose in poses])

    scene, smooth = make_scene(sphere), jd.LargeSteps(sphere, lam=10.0)
    optimiser = jd.adam_uniform(optax.cosine_decay_schedule(0.1, steps, alpha=0.1))

    def loss(latent, view, key):
        moved = scene.replace({"figure.vertices": smooth.from_latent(latent)})
        return jd.losses.l2(image(moved, poses[view], key, SAMPLES), targets[view])

    @jax.jit
    def step(latent, state, view, key):
        updates, state = optimiser.update(jax.grad(loss)(latent, view, key), state)
        return optax.apply_updates(latent, updates), state

    latent = smooth.to_latent(sphere.vertices)
    state = optimiser.init(latent)
    for i in range(steps):
        latent, state = step(latent, state, i % VIEWS, jax.random.key(i))
    result = sphere.with_vertices(smooth.from_latent(latent))
    jd.save_mesh("figure.glb", result)
    return jd.chamfer(sphere, pawn), jd.chamfer(result, pawn)


if __name__ == "__main__":
    with jd.working("finding the figure"):
        distances = main()
    print("Chamfer distance: {:.4f} before, {:.4f} after".format(*distances))
