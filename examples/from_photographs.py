"""From photographs: a folder of pictures with known cameras becomes a mesh with colours. First run take_photographs.py.

Shape, colours and sky are found together, and judged by photographs that were held out. `jaxdr reconstruct` does it
with more care: levels from coarse to fine, roughness, any sky, textures (docs/reconstruct.md).
"""

import jax
import jax.numpy as jnp
import optax

import jaxdr as jd

SAMPLES, STEPS = 4, 300


def main(folder: str = "photographs", steps: int = STEPS) -> tuple[float, float]:
    """Writes found.glb; returns the mean PSNR of the held-out photographs, in dB, before and after."""
    views = jd.load_views(folder)
    photographs = jnp.stack([view.image for view in views.fitted])  # [N, H, W, 3], linear RGB
    poses = jnp.stack([jnp.asarray(view.to_world, jnp.float32) for view in views.fitted])
    sphere = jd.shapes.sphere(4, radius=0.4)
    grey = jd.VertexColors(jnp.full((len(sphere.vertices), 3), 0.5))
    # All photographs were taken by one lens, so one camera with another pose does for all of them.
    sky = jd.EnvironmentMap(jnp.ones((8, 16, 3)))
    scene = jd.Scene({"object": jd.Shape(sphere, jd.Diffuse(grey))}, views.fitted[0].camera, sky)
    smooth = jd.LargeSteps(sphere, lam=5.0)

    # The optimiser's numbers have no bounds. Colours in (0, 1) and a sky above zero are made from them.
    def found(latent):
        vertices = smooth.from_latent(latent["shape"])
        colors, sky = jax.nn.sigmoid(latent["paint"]), jnp.exp(latent["sky"])
        names = ("object.vertices", "object.bsdf.reflectance.colors", "environment.radiance")
        return scene.replace(dict(zip(names, (vertices, colors, sky), strict=True)))

    def loss(latent, number, key):
        seen = found(latent).replace({"camera.to_world": poses[number]})
        return jd.losses.l1(jd.render(seen, key, SAMPLES, jd.PathTracer(max_depth=2)), photographs[number])

    rates = {"shape": jd.adam_uniform(0.03), "paint": optax.adam(0.05), "sky": optax.adam(0.05)}
    optimiser = optax.multi_transform(rates, {name: name for name in rates})

    @jd.jit
    def step(latent, state, number, key):
        updates, state = optimiser.update(jax.grad(loss)(latent, number, key), state)
        return optax.apply_updates(latent, updates), state

    grey = jnp.zeros_like(sphere.vertices)
    latent = {"shape": smooth.to_latent(sphere.vertices), "paint": grey, "sky": jnp.zeros((8, 16, 3))}
    start, state = latent, optimiser.init(latent)
    for i in range(steps):
        latent, state = step(latent, state, i % len(poses), jax.random.key(i))
    psnr = [jd.evaluate_views(found(x), views).to_dict()["psnr"]["mean"] for x in (start, latent)]
    jd.save_mesh("found.glb", sphere.with_vertices(smooth.from_latent(latent["shape"])))
    return psnr[0], psnr[1]


if __name__ == "__main__":
    with jd.working("finding shape, colours and sky"):
        psnr = main()
    print("PSNR of held-out photographs: {:.1f} dB before, {:.1f} dB after".format(*psnr))
