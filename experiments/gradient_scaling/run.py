"""Time and memory of the gradient of an image loss with respect to every vertex of a sphere.

    python -m experiments.gradient_scaling.run

Each point runs in a fresh process, so that its peak memory is its own. The last part compiles the first gradient of
a small scene in two processes. They share a persistent compilation cache, which is empty for the first one.
"""

import os
import statistics
import tempfile
import time

from experiments import common

STUDY = "gradient_scaling"
SAMPLES = (16, 64, 256)
TRIANGLES = (20_000, 80_000, 320_000, 1_000_000)
SAMPLE_COLUMNS = {
    "samples per pixel": ("spp", ""),
    "seconds a gradient": ("seconds", ".2f"),
    "peak memory, MB": ("peak_megabytes", ".0f"),
    "of which before compiling, MB": ("before_megabytes", ".0f"),
    "XLA's buffers, MB": ("buffer_megabytes", ".0f"),
    "first call, seconds": ("first", ".1f"),
}
TRIANGLE_COLUMNS = {"triangles": ("triangles", ",d"), **SAMPLE_COLUMNS}
COMPILE_COLUMNS = {
    "": ("cache", ""),
    "import, s": ("import_seconds", ".1f"),
    "scene, s": ("scene_seconds", ".1f"),
    "first gradient, s": ("first", ".1f"),
    "second gradient, s": ("seconds", ".2f"),
}


def scene_of(vertex_count, resolution):
    """A sphere above a floor under an area light: it is seen directly and casts a soft shadow."""
    import numpy as np

    import jaxdr as jd
    from jaxdr.geometry import shapes

    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[:3, 3] = (-1.0, 0.5, 4.0)
    light = shapes.transformed(shapes.rectangle(0.8, 0.8), down)
    ball = shapes.sphere(vertex_count=vertex_count, radius=0.8, center=(0, 0, 1))
    return jd.Scene(
        shapes={
            "sphere": jd.Shape(ball, jd.Diffuse(0.6)),
            "floor": jd.Shape(shapes.rectangle(10, 10), jd.Diffuse(0.5)),
            "light": jd.Shape(light, jd.Diffuse(0.0), emitter=jd.AreaEmitter(30.0)),
        },
        camera=jd.Perspective(
            to_world=jd.look_at((0, -5, 3), (0, 0, 0.7), (0, 0, 1)),
            fov=35.0,
            film=jd.Film(resolution, resolution, jd.Box()),
        ),
    )


def gradient(vertex_count, resolution, spp, calls):
    """Seconds and peak memory of the gradient of an L2 loss with respect to all vertices of the sphere."""
    start = time.perf_counter()
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    imported = time.perf_counter()
    scene = scene_of(vertex_count, resolution)
    integrator = jd.PathTracer(max_depth=2, boundary=jd.KernelDensity())
    vertices = scene.parameters()["sphere.vertices"]

    @jd.jit
    def loss_gradient(vertices, key):
        def loss(v):
            image = jd.render(scene.replace({"sphere.vertices": v}), key, spp=spp, integrator=integrator)
            return jnp.mean((image - 0.25) ** 2)

        return jax.value_and_grad(loss)(vertices)

    built, before = time.perf_counter(), common.peak_memory()
    (_, answer), first = common.seconds_of(loss_gradient, vertices, jax.random.key(0))
    if not bool(jnp.isfinite(answer).all()):
        raise ValueError("the gradient is not finite")
    seconds = [common.seconds_of(loss_gradient, vertices, jax.random.key(k))[1] for k in range(1, calls + 1)]
    peak = common.peak_memory()  # before the program is compiled again to ask for its buffers
    buffers = loss_gradient.lower(vertices, jax.random.key(0)).compile().memory_analysis().temp_size_in_bytes
    return {
        "triangles": len(scene.shapes["sphere"].mesh.faces),
        "spp": spp,
        "resolution": resolution,
        "import_seconds": imported - start,
        "scene_seconds": built - imported,
        "first": first,
        "seconds": statistics.median(seconds),
        "all_seconds": seconds,
        "before_megabytes": before / 1e6,
        "peak_megabytes": peak / 1e6,
        "buffer_megabytes": buffers / 1e6,
    }


def compile_times(vertex_count):
    """Rows of a first gradient without any cache, and of one in a second process with the first one's cache."""
    kept = {name: os.environ.get(name) for name in ("JAX_COMPILATION_CACHE_DIR", "WARP_CACHE_PATH")}
    entries = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"
    kept |= {name: os.environ.get(name) for name in entries}
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"JAX_COMPILATION_CACHE_DIR": f"{folder}/jax", "WARP_CACHE_PATH": f"{folder}/warp"}
        os.environ |= {entries[0]: "0", entries[1]: "-1"}
        rows = [common.in_fresh_process(gradient, vertex_count, 64, 16, 2) for _ in range(2)]
    for name, value in kept.items():
        os.environ.pop(name) if value is None else os.environ.update({name: value})
    return [{"cache": label, **row} for label, row in zip(("cold", "persistent cache"), rows, strict=True)]


def chart(samples, triangles, path):
    """Memory against samples per pixel; time against triangles."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
    left.semilogx([r["spp"] for r in samples], [r["peak_megabytes"] for r in samples], "o-")
    left.set(xlabel="samples per pixel", ylabel="peak memory, MB", ylim=(0, None))
    right.semilogx([r["triangles"] for r in triangles], [r["seconds"] for r in triangles], "o-")
    right.set(xlabel="triangles", ylabel="seconds a gradient", ylim=(0, None))
    for axes in (left, right):
        axes.grid(True, alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--resolution", type=int, default=128)
    options = parser.parse_args()
    resolution, calls = (32, 1) if options.quick else (options.resolution, 3)
    vertex_count = 2_000 if options.quick else 40_000
    counts = SAMPLES[:2] if options.quick else SAMPLES
    sizes = TRIANGLES[:2] if options.quick else TRIANGLES

    print(f"Gradient with respect to {vertex_count:,} vertices, {resolution}x{resolution}")
    samples = []
    for spp in counts:
        samples.append(common.in_fresh_process(gradient, vertex_count, resolution, spp, calls))
        print(f"  {spp} spp: {samples[-1]['seconds']:.2f} s, {samples[-1]['peak_megabytes']:.0f} MB", flush=True)
    print(f"Gradient with respect to all vertices, {resolution}x{resolution}, 16 spp")
    triangles = []
    for size in sizes:
        triangles.append(common.in_fresh_process(gradient, size // 2 + 2, resolution, 16, calls))
        print(f"  {triangles[-1]['triangles']:,} triangles: {triangles[-1]['seconds']:.2f} s", flush=True)
    print("First gradient, 64x64, 16 spp")
    compiled = compile_times(vertex_count)

    folder = common.results(STUDY, options.quick)
    numbers = {"samples": samples, "triangles": triangles, "compile": compiled}
    common.write_json(folder / "gradient_scaling.json", numbers)
    chart(samples, triangles, folder / "gradient_scaling.png")
    growth, planned = (samples[-1][key] / samples[0][key] - 1 for key in ("peak_megabytes", "buffer_megabytes"))
    slower = triangles[-1]["seconds"] / triangles[0]["seconds"]
    print("\n" + common.table(samples, SAMPLE_COLUMNS) + "\n\n" + common.table(triangles, TRIANGLE_COLUMNS))
    print("\n" + common.table(compiled, COMPILE_COLUMNS))
    print(f"\nMemory from {counts[0]} to {counts[-1]} spp: {growth:+.0%} (XLA's buffers {planned:+.0%}). ", end="")
    print(f"Time from {triangles[0]['triangles']:,} to {triangles[-1]['triangles']:,} triangles: x{slower:.2f}.")


if __name__ == "__main__":
    main()
