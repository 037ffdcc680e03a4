"""What it costs that paths go on over black surfaces: README's scene, by what is differentiated.

Prints, for each gradient, the equations of its program, seconds a call, and the variance of the gradient times seconds.
Run it in two checkouts in turns to compare them: `python -m experiments.borders.price`.
"""

import argparse
import time

import jax
import numpy as np

import jaxdr as jd
from experiments.program_size import equations

CALLS = 12


def scene(size: int) -> jd.Scene:
    """README's scene; its lamp is black, so paths that meet it carry nothing."""
    ball = jd.Shape(jd.shapes.sphere(3, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse((0.8, 0.5, 0.3)))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    return jd.Scene(
        shapes={"ball": ball, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0))},
        camera=jd.Perspective(jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), fov=35.0, film=jd.Film(size, size)),
    )


def measure(of: jd.Scene, names: tuple[str, ...], spp: int) -> dict[str, float]:
    """Equations, seconds a call (median), and summed variance of the gradient times seconds."""
    values = {name: of.parameters()[name] for name in names}

    def loss(values, key):
        return (jd.render(of.replace(values), key, spp) ** 2).mean()

    gradient = jax.grad(loss)
    keys = jax.random.split(jax.random.key(0), CALLS)
    size = sum(1 for _ in equations(jax.make_jaxpr(gradient)(values, keys[0]).jaxpr))
    compiled = jax.jit(gradient)
    jax.block_until_ready(compiled(values, keys[0]))
    rows, times = [], []
    for key in keys:
        start = time.perf_counter()
        rows.append(
            np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(jax.block_until_ready(compiled(values, key)))])
        )
        times.append(time.perf_counter() - start)
    seconds, variance = float(np.median(times)), float(np.var(np.stack(rows).astype(float), axis=0, ddof=1).sum())
    return {"equations": size, "seconds": seconds, "variance x seconds": variance * seconds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=16)
    options = parser.parse_args()
    of = scene(options.size)
    colours = ("ball.bsdf.reflectance", "floor.bsdf.reflectance")
    for title, names in (
        ("vertices", ("ball.vertices",)),
        ("reflectances", colours),
        ("both", ("ball.vertices", *colours)),
    ):
        found = measure(of, names, options.spp)
        print(title, *(f"{name} {value:.4g}" for name, value in found.items()), sep="; ", flush=True)


if __name__ == "__main__":
    main()
