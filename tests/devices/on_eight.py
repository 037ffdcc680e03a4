"""What eight virtual devices of one process compute, beside one of them; prints JSON. Run by test_devices.py."""

import json
import os
from functools import partial

os.environ["JAX_NUM_CPU_DEVICES"] = "8"  # read when the first array is made

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import jaxdr as jd
from jaxdr.geometry.queries.warp import queries as warp_queries
from jaxdr.optimize.devices import Divided, Division, divide
from jaxdr.optimize.phase import view_gradient

SPP = 4
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}  # where bits are not compared


def counted(monitored: list):
    """Count the rays of all queries by Warp from now on."""

    def spied(original, position, *arguments):
        monitored.append(arguments[position])
        return original(*arguments)

    for name, position in (("launch", 1), ("compact", 3)):
        setattr(warp_queries, name, partial(spied, getattr(warp_queries, name), position))


def scene(size: int = 12) -> jd.Scene:
    """A ball over a floor under a lamp."""
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    return jd.Scene(
        shapes={
            "ball": jd.Shape(jd.shapes.sphere(1, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse(0.5)),
            "floor": jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5))),
            "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0)),
        },
        camera=jd.Perspective(jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), fov=35.0, film=jd.Film(size, size)),
    )


def main():
    found = {"devices": jax.device_count()}
    made, tracer = scene(), jd.PathTracer(max_depth=2)
    vertices = made.parameters()["ball.vertices"]
    offset = jnp.asarray([0.1, 0.0, 0.0])
    keys = jax.random.split(jax.random.key(0), 8)
    mesh = jax.make_mesh((8,), ("views",), axis_types=(AxisType.Auto,))

    def image(offset, key, tracer=tracer):
        return jd.render(made.replace({"ball.vertices": vertices + offset}), key, SPP, tracer)

    def loss(offset, key):
        return jnp.mean(image(offset, key) ** 2)

    # shard_map with its checks; the gradient by what all devices have in common is a sum over them.
    def on_each(offset, keys):
        value, gradient = jax.value_and_grad(loss)(offset, keys[0])
        return jax.lax.pmean(value, "views"), gradient / 8

    specs = {"in_specs": (PartitionSpec(), PartitionSpec("views")), "out_specs": (PartitionSpec(), PartitionSpec())}
    sharded = jax.shard_map(on_each, mesh=mesh, check_vma=True, **specs)
    mapped = jax.jit(sharded, compiler_options=QUICK)(offset, keys)
    single = jax.jit(jax.value_and_grad(loss), compiler_options=QUICK)
    alone = [single(offset, key) for key in keys]
    mean = jax.tree.map(lambda *x: sum(x) / 8, *alone)
    found["shard_map"] = [[np.asarray(x).tolist() for x in pair] for pair in (mapped, mean)]

    # jit of a batch, with the keys on one device or on eight; shard_map over two.
    batch, one_by_one = jax.jit(jax.vmap(image, in_axes=(None, 0))), jax.jit(image)
    two = jax.make_mesh((2,), ("views",), axis_types=(AxisType.Auto,), devices=jax.devices()[:2])
    specs = {"in_specs": PartitionSpec("views"), "out_specs": PartitionSpec("views")}
    over_two = jax.jit(jax.shard_map(lambda keys: jax.lax.map(partial(image, offset), keys), mesh=two, **specs))
    images = [np.stack([np.asarray(one_by_one(offset, key)) for key in keys]), np.asarray(over_two(keys))]
    # Queries by Embree do not come by Python, so those by Warp are counted.
    by_warp = partial(image, tracer=jd.PathTracer(max_depth=2, rays="warp"))
    counted_batch = jax.jit(jax.vmap(by_warp, in_axes=(None, 0)))
    numbers, rays = [], []
    counted(rays)
    for placed in (keys, jax.device_put(keys, NamedSharding(mesh, PartitionSpec("views")))):
        images.append(np.asarray(batch(offset, placed)))
        rays.clear()
        counted_batch(offset, placed).block_until_ready()
        numbers.append([len(rays), sum(rays)])
    found["same bits"] = [bool(np.array_equal(images[0], other)) for other in images[1:]]
    found["rays"] = numbers

    # Steps of an optimisation: five views on one, two and eight devices, a view by eight devices.
    def of_view(common, view):
        def moved(offset, to_world, key, spp):
            scene = made.replace({"ball.vertices": vertices + offset, "camera.to_world": to_world})
            return jd.render(scene, key, spp, jd.PathTracer(max_depth=2, boundary=None))

        return view_gradient(moved, "l2", SPP, SPP)(common, *view)

    pose = made.parameters()["camera.to_world"]
    views = [(pose, images[0][i], key) for i, key in enumerate(keys[:5])]
    steps = {}
    for count in (1, 2, 8):
        devices = jax.devices()[:count]
        steps[count] = [
            jax.tree.map(np.asarray, x) for x in Divided(of_view, Division(count, 1), devices)(offset, views)
        ]
    found["steps alike"] = [
        max(float(np.abs(a - b).max()) for a, b in zip(jax.tree.leaves(steps[8]), jax.tree.leaves(other), strict=True))
        for other in (steps[2], steps[1])
    ]
    found["size of a step"] = float(np.abs(steps[1][0][1]).max())
    division = divide(1, 8, 8)

    def shared(common, key):
        return division.mean(common * jax.random.uniform(division.own_key(key)))

    (mean,) = Divided(shared, division, jax.devices())(jnp.float32(2.0), keys[:1])
    shares = [2.0 * float(jax.random.uniform(jax.random.fold_in(keys[0], i))) for i in range(division.shares)]
    found["shares"] = [division.shares, float(mean), float(np.mean(shares))]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
