"""The cost of images and gradients: time per path; memory per face, path and pixel; bytes that devices exchange.

    python -m experiments.scaling.costs

The scene is a flat-shaded sphere above a floor under a lamp, with direct light (depth 2) and one bounce more (depth 3).
A line through two numbers of samples gives the seconds of every call and of every path. Memory is counted from arrays,
from XLA's plans, or as the growth of the process. Bytes are counted in the compiled program of two devices.
"""

import os
import re
import statistics
import time

from experiments import common
from experiments.gradient_scaling.run import scene_of

STUDY = "scaling"
SAMPLES = (8, 32)
WHAT = {"image": ("image", None), "interior": ("gradient", None), "whole": ("gradient", "KernelDensity")}
KINDS = {"f32": 4, "s32": 4, "u32": 4, "f64": 8, "pred": 1}


def program(what: str, vertex_count: int, resolution: int, depth: int, spp: int, chunk_size: int | None = None):
    """(jitted function of (vertices, key), vertices): an image, or the gradient of a loss by all vertices."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    mode, boundary = WHAT[what]
    scene = scene_of(vertex_count, resolution)
    term = boundary and getattr(jd, boundary)()
    integrator = jd.PathTracer(max_depth=depth, boundary=term, chunk_size=chunk_size)

    def image(vertices, key):
        return jd.render(scene.replace({"sphere.vertices": vertices}), key, spp=spp, integrator=integrator)

    def loss(vertices, key):
        return jnp.mean((image(vertices, key) - 0.25) ** 2)

    return jd.jit(image if mode == "image" else jax.grad(loss)), scene.parameters()["sphere.vertices"]


def seconds(what: str, vertex_count: int, resolution: int, depth: int, calls: int) -> list[dict]:
    """Medians of wall-clock and processor seconds of a call with few and with many samples, in turns."""
    import jax

    programs = [program(what, vertex_count, resolution, depth, spp) for spp in SAMPLES]
    for function, vertices in programs:
        jax.block_until_ready(function(vertices, jax.random.key(0)))
    found: list[dict] = [{"wall": [], "processor": []} for _ in programs]
    for k in range(1, calls + 1):
        for (function, vertices), times in zip(programs, found, strict=True):
            start = time.process_time()
            times["wall"].append(common.seconds_of(function, vertices, jax.random.key(k))[1])
            times["processor"].append(time.process_time() - start)
    return [{clock: statistics.median(values) for clock, values in times.items()} for times in found]


def per_path(vertex_count: int, resolution: int, calls: int) -> list[dict]:
    """What calls cost: a part for each path, and a part that does not depend on their number."""
    rows = []
    for depth in (2, 3):
        for what in WHAT:
            few, many = common.in_fresh_process(seconds, what, vertex_count, resolution, depth, calls)
            paths = resolution**2 * (SAMPLES[1] - SAMPLES[0])
            row = {"what": what, "depth": depth, "few": few, "many": many}
            for clock in ("wall", "processor"):
                each = (many[clock] - few[clock]) / paths
                row[f"{clock}_microseconds"] = 1e6 * each
                row[f"{clock}_fixed"] = few[clock] - each * resolution**2 * SAMPLES[0]
            rows.append(row)
            print(f"  {what}, depth {depth}: {row['processor_microseconds']:.2f} µs a path", flush=True)
    return rows


def array_bytes(vertex_count: int) -> dict:
    """Bytes of the arrays of a packed scene and of its tree over edges, and numbers of faces and vertices."""
    import jax
    import jax.numpy as jnp

    from jaxdr.geometry import queries
    from jaxdr.scene.packed import pack

    scene = scene_of(vertex_count, 8)
    packed = pack(scene)
    table = queries.EdgeSet.of(packed.edges, jnp.ones(len(packed.edges.vertices)))
    tree = queries.edge_tree(queries.Geometry(packed.vertices, packed.faces), table)
    size = lambda arrays: sum(a.nbytes for a in jax.tree.leaves(arrays) if hasattr(a, "nbytes"))  # noqa: E731
    edges = size(packed.edges)
    mesh = scene.shapes["sphere"].mesh
    return {
        "faces": len(mesh.faces),
        "vertices": len(mesh.vertices),
        "tables": size(packed) - edges,
        "edges": edges,
        "tree": size(tree),
    }


def structure_bytes(kind: str, vertex_count: int, copies: int) -> float:
    """Bytes per face by which this process grows when structures are built over moved copies of a sphere.

    `kind`: "embree", or one of those of Warp.
    """
    import numpy as np
    import warp as wp

    from jaxdr.geometry import shapes
    from jaxdr.geometry.queries.embree import queries as embree
    from jaxdr.geometry.queries.warp.structures import structure_cache

    mesh = shapes.sphere(vertex_count=vertex_count)
    faces, vertices = np.array(mesh.faces, np.int32), np.array(mesh.vertices, np.float32)
    cache = embree._scenes
    if kind != "embree":
        cache = structure_cache(kind, wp.get_device("cpu"))
    cache.find([vertices], [faces])  # libraries and kernels are loaded now
    cache.per_topology = cache.capacity = copies + 1
    before = resident()
    for k in range(copies):
        cache.find([vertices * np.float32(1.5 + k)], [faces])
    return (resident() - before) / copies / len(faces)


def resident() -> int:
    """Resident memory of this process, in bytes (Linux)."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def planned_bytes(what: str, resolution: int, depth: int, chunk_size: int) -> int:
    """What XLA plans for intermediate results of a call with chunks of paths of this size."""
    import jax

    spp = 2 * -(-chunk_size // resolution**2)
    function, vertices = program(what, 2_000, resolution, depth, spp, chunk_size)
    return function.lower(vertices, jax.random.key(0)).compile().memory_analysis().temp_size_in_bytes


def exchanged_bytes(vertex_count: int, resolution: int) -> dict:
    """What two devices exchange in a step that divides views: the collectives in the compiled program."""
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
    import jax
    from jax.sharding import Mesh
    from jax.sharding import PartitionSpec as P

    function, vertices = program("whole", vertex_count, resolution, 2, 1)
    mesh = Mesh(jax.devices(), ("device",))

    def step(vertices, keys):
        return jax.lax.psum(function.__wrapped__(vertices, keys[0]), "device")

    # Marked as different on each device: else JAX sums the derivative itself, and this one would be the second.
    def own(vertices, keys):
        return step(jax.lax.pcast(vertices, "device", to="varying"), keys)

    divided = jax.jit(jax.shard_map(own, mesh=mesh, in_specs=(P(), P("device")), out_specs=P()))
    text = divided.lower(vertices, jax.random.split(jax.random.key(0), 2)).compile().as_text()
    found = {}
    for shapes, name in re.findall(r"= (\S.*?) (all-\w+|reduce-scatter|collective-\w+)\(", text):
        sizes = [eval("*".join(s.split(",")) or "1") * KINDS[k] for k, s in re.findall(r"(\w+)\[([\d,]*)\]", shapes)]
        found[name] = found.get(name, 0) + sum(sizes)
    return {"collectives": found, "gradient": vertices.nbytes}


def memory(quick: bool) -> dict:
    """Bytes a face, a path and a pixel."""
    sizes = (1_000, 4_000) if quick else (10_000, 40_000)
    small, large = (common.in_fresh_process(array_bytes, n) for n in sizes)
    faces = large["faces"] - small["faces"]
    face = {key: (large[key] - small[key]) / faces for key in ("tables", "edges", "tree")}
    for kind in ("embree", "mesh", "faces"):
        face[kind] = common.in_fresh_process(structure_bytes, kind, sizes[1], 2 if quick else 8)
    chunks, pixels = (1 << 10, 1 << 11) if quick else (1 << 15, 1 << 16), (16, 32) if quick else (128, 256)
    path = {}
    for what in WHAT:
        few, many = (common.in_fresh_process(planned_bytes, what, pixels[0], 2, chunk) for chunk in chunks)
        scale = 4 if what == "image" else 1  # images take four times as many paths at once as they are told
        path[what] = (many - few) / (chunks[1] - chunks[0]) / scale
    small_image, large_image = (common.in_fresh_process(planned_bytes, "whole", p, 2, chunks[1]) for p in pixels)
    pixel = (large_image - small_image) / (pixels[1] ** 2 - pixels[0] ** 2)
    return {"face": face, "path": path, "pixel": pixel}


def main():
    parser = common.parser(__doc__)
    options = parser.parse_args()
    vertex_count, resolution, calls = (1_000, 16, 1) if options.quick else (40_000, 128, 5)
    numbers: dict = {"load": os.getloadavg()[0], "resolution": resolution, "vertices": vertex_count}
    print("Memory", flush=True)
    numbers["memory"] = memory(options.quick)
    print(f"  {numbers['memory']}\nExchange", flush=True)
    numbers["exchange"] = common.in_fresh_process(exchanged_bytes, 1_000 if options.quick else 10_000, 16)
    print(f"  {numbers['exchange']}\nTime", flush=True)
    numbers["time"] = per_path(vertex_count, resolution, calls)
    common.write_json(common.results(STUDY, options.quick) / "costs.json", numbers)
    columns = {
        "": ("what", ""),
        "depth": ("depth", "d"),
        "µs a path, all cores": ("wall_microseconds", ".2f"),
        "processor µs a path": ("processor_microseconds", ".2f"),
        "every call, s": ("wall_fixed", ".3f"),
        "every call, processor s": ("processor_fixed", ".3f"),
    }
    print("\n" + common.table(numbers["time"], columns))


if __name__ == "__main__":
    main()
