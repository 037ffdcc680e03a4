"""Images and gradients by row kernels and by XLA: python -m experiments.row_kernels.run [--depth N] [--boundary NAME]

Prints seconds of the first call, medians of seconds a call in turns, cores used, and how far results are apart.
"""

import argparse
import resource
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd

BOUNDARIES = {"none": None, "kernel density": jd.KernelDensity(), "line sampling": jd.LineSampling()}


def scene(size: int) -> jd.Scene:
    """README's scene."""
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    return jd.Scene(
        shapes={
            "ball": jd.Shape(jd.shapes.sphere(3, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse((0.8, 0.5, 0.3))),
            "floor": jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5))),
            "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0)),
        },
        camera=jd.Perspective(jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), fov=35.0, film=jd.Film(size, size)),
    )


def processor() -> float:
    """Processor seconds of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def compared(name: str, functions: dict, calls: int) -> None:
    """Print a row of the table for functions of a key."""
    first, seconds, cores, results = {}, {way: [] for way in functions}, {}, {}
    for way, function in functions.items():
        start = time.perf_counter()
        results[way] = np.asarray(jax.block_until_ready(function(jax.random.key(0))))
        first[way] = time.perf_counter() - start
    for call in range(calls):
        for way, function in functions.items():
            start, used = time.perf_counter(), processor()
            jax.block_until_ready(function(jax.random.key(call)))
            seconds[way].append(time.perf_counter() - start)
            cores[way] = (processor() - used) / seconds[way][-1]
    median = {way: statistics.median(times) for way, times in seconds.items()}
    kernels, *others = results.values()
    apart = max(float(np.abs(kernels - other).max() / np.abs(other).max()) for other in others)
    cells = [f"{first[w]:.1f}, {median[w]:.3f}, {cores[w]:.2f}" for w in functions]
    ratio = median["jax.jit"] / median["kernels"]
    print(f"| {name} | {' | '.join(cells)} | {ratio:.2f} | {apart:.1e} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--depth", type=int, default=2)
    parser.add_argument("--calls", type=int, default=9)
    parser.add_argument("--boundary", choices=[*BOUNDARIES, "all"], default="all")
    given = parser.parse_args()
    stage = scene(given.size)
    vertices = stage.parameters()["ball.vertices"]

    def image(compute):
        integrator = jd.PathTracer(max_depth=given.depth, compute=compute)
        return lambda key: jd.render(stage, key, given.spp, integrator)

    def gradient(compute, boundary):
        integrator = jd.PathTracer(max_depth=given.depth, boundary=boundary, compute=compute)

        def loss(offset, key):
            moved = stage.replace({"ball.vertices": vertices + offset})
            return jnp.square(jd.render(moved, key, given.spp, integrator)).mean()

        return lambda key: jax.grad(loss)(jnp.asarray([0.1, 0.0, 0.0]), key)

    print("| | kernels: first, each, cores | jax.jit | jd.jit | jax.jit / kernels | apart |\n|---|---|---|---|---|---|")

    def ways(make, *arguments):
        kernels, xla = make("kernels", *arguments), make("xla", *arguments)
        return {"kernels": jax.jit(kernels), "jax.jit": jax.jit(xla), "jd.jit": jd.jit(xla)}

    compared("image", ways(image), given.calls)
    for name, boundary in BOUNDARIES.items():
        if given.boundary in (name, "all"):
            compared(f"gradient, {name}", ways(gradient, boundary), given.calls)


if __name__ == "__main__":
    main()
