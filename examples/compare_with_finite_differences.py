"""Compare with finite differences: the check to make whenever you doubt a gradient.

Take a derivative in two ways: by `jax.jvp`, and as a difference of two images. Both images of a difference share their
key, so that their noise cancels. Average over keys, and judge by the standard error.
"""

import jax
import jax.numpy as jnp

import jaxdr as jd

PIXELS, SAMPLES, MANY, KEYS, STEP = 24, 64, 512, 16, 0.02


def make_scene() -> jd.Scene:
    """A box above a floor, under a lamp."""
    box = jd.Shape(jd.shapes.box(0.7, center=(0.0, 0.0, 0.6)), jd.Diffuse(0.6))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((1.5, 0, 3), (0, 0, 0.5), (0, 1, 0)))
    shapes = {"box": box, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(15.0))}
    camera = jd.Perspective(jd.look_at((0, -4, 3), (0, 0, 0.4), (0, 0, 1)), 36.0, jd.Film(PIXELS, PIXELS))
    return jd.Scene(shapes, camera)


def main() -> tuple[float, float]:
    """Prints both means over the image's left half; returns their ratio and its standard error."""
    scene = make_scene()
    vertices = scene.parameters()["box.vertices"]

    def mean(x, key, spp, tracer):
        moved = scene.replace({"box.vertices": vertices + x * jnp.array([1.0, 0.0, 0.0])})
        return jd.render(moved, key, spp, tracer)[:, : PIXELS // 2].mean()

    tracer = jd.PathTracer(max_depth=2)
    plain = jd.PathTracer(max_depth=2, boundary=None)  # images need no boundary terms

    @jax.jit
    def by_jvp(key):
        return jax.jvp(lambda x: mean(x, key, SAMPLES, tracer), (0.0,), (1.0,))[1]

    @jax.jit
    def by_difference(key):
        return (mean(STEP, key, MANY, plain) - mean(-STEP, key, MANY, plain)) / (2 * STEP)

    keys = jax.random.split(jax.random.key(0), KEYS)
    with jd.working("compiling and rendering"):
        ours, theirs = (jnp.array([function(key) for key in keys]) for function in (by_jvp, by_difference))
    for name, values in (("jvp", ours), ("finite differences", theirs)):
        print(f"{name:20s} {values.mean():.5f} ± {values.std() / KEYS**0.5:.5f}")
    ratio = ours.mean() / theirs.mean()
    error = jnp.hypot(ours.std() / ours.mean(), theirs.std() / theirs.mean()) / KEYS**0.5
    return float(ratio), float(jnp.abs(ratio * error))


if __name__ == "__main__":
    print("ratio {:.3f} ± {:.3f}".format(*main()))
