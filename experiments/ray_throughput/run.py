"""Closest-hit throughput of the query implementations and of embreex, on bumpy spheres of 1e2 to 1e6 triangles.

python -m experiments.ray_throughput.run
"""

import statistics

import numpy as np

from experiments import common

STUDY = "ray_throughput"
SIZES = (100, 1_000, 10_000, 82_000, 300_000, 1_000_000)
RAYS = 1 << 20
TESTS = 1e8  # ray-triangle tests spent on one call of the implementation that has no tree
COLUMNS = {
    "triangles": ("triangles", ",d"),
    "embree, Mrays/s": ("embree", ".2f"),
    "warp, Mrays/s": ("warp", ".2f"),
    "jax, Mrays/s": ("jax", ".4f"),
    "embreex (one thread), Mrays/s": ("embreex", ".2f"),
    "embree / warp": ("ratio", ".2f"),
    "embree, first call with its tree, s": ("embree_first", ".2f"),
    "warp, the same, s": ("warp_first", ".2f"),
}


def random_rays(count, seed=0):
    """Incoherent rays from the sphere of radius 2 towards points in the unit ball, [count, 3] each, float32."""
    random = np.random.default_rng(seed)
    origin, inside = random.normal(size=(2, count, 3))
    origin *= 2 / np.linalg.norm(origin, axis=1, keepdims=True)
    inside *= (random.random(count) ** (1 / 3) / np.linalg.norm(inside, axis=1))[:, None]
    direction = inside - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return origin.astype(np.float32), direction.astype(np.float32)


def mesh_of(triangles):
    """A bumpy sphere of about that many triangles."""
    from jaxdr.geometry.shapes import displaced_sphere

    return displaced_sphere(vertex_count=triangles // 2 + 2)


def ours(triangles, implementation, rays, calls):
    """(triangles, Mrays/s, seconds of the first call after compilation, hits) of a jitted `closest_hit`."""
    import jax.numpy as jnp

    import jaxdr as jd
    from jaxdr.geometry.queries import Geometry, Rays, closest_hit

    mesh = mesh_of(triangles)
    origin, direction = (jnp.asarray(a) for a in random_rays(rays))
    rays_there = Rays(origin, direction, jnp.full(rays, 1e6, jnp.float32))

    @jd.jit
    def trace(vertices):
        return closest_hit(Geometry(vertices, mesh.faces), rays_there, implementation)

    compiled = trace.lower(mesh.vertices).compile()
    hit, first = common.seconds_of(compiled, mesh.vertices)
    seconds = [common.seconds_of(compiled, mesh.vertices)[1] for _ in range(calls)]
    return len(mesh.faces), rays / statistics.median(seconds) / 1e6, first, int((np.asarray(hit.face) >= 0).sum())


def embreex_itself(triangles, rays, calls):
    """(Mrays/s, hits) of the package's own function; the tree is built before."""
    import time

    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    mesh = mesh_of(triangles)
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32))
    origin, direction = random_rays(rays)
    face = scene.run(origin, direction)
    seconds = []
    for _ in range(calls):
        start = time.perf_counter()
        scene.run(origin, direction)
        seconds.append(time.perf_counter() - start)
    return rays / statistics.median(seconds) / 1e6, int((face >= 0).sum())


def chart(rows, path):
    """Mrays/s against triangles, log-log."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    labels = {"embree": "embree", "warp": "warp", "jax": "jax", "embreex": "embreex itself, one thread"}
    figure, axes = plt.subplots(figsize=(5.6, 4))
    for name, label in labels.items():
        axes.loglog([r["triangles"] for r in rows], [r[name] for r in rows], "o-", label=label)
    axes.set(xlabel="triangles", ylabel="closest hits, Mrays/s")
    axes.grid(True, alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    options = common.parser(__doc__).parse_args()
    rays, calls, sizes = (1 << 16, 2, SIZES[:3]) if options.quick else (RAYS, 5, SIZES)
    rows = []
    for size in sizes:
        row = {"rays": rays, "jax_rays": int(np.clip(TESTS / size, 64, rays))}
        for name, count, n in (("embree", rays, calls), ("warp", rays, calls), ("jax", row["jax_rays"], 2)):
            measured = common.in_fresh_process(ours, size, name, count, n)
            row["triangles"], row[name], row[f"{name}_first"], row[f"{name}_hits"] = measured
        row["embreex"], row["embreex_hits"] = common.in_fresh_process(embreex_itself, size, rays, calls)
        row["ratio"] = row["embree"] / row["warp"]
        rows.append(row)
        print(common.table([row], COLUMNS).splitlines()[-1], flush=True)
    folder = common.results(STUDY, options.quick)
    common.write_json(folder / "ray_throughput.json", {"rows": rows})
    chart(rows, folder / "ray_throughput.png")
    print("\n" + common.table(rows, COLUMNS))


if __name__ == "__main__":
    main()
