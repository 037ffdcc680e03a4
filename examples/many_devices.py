"""The gradient over eight views, divided over all devices: the GPUs if there are any, otherwise the CPU as two."""

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import jaxdr as jd

jax.config.update("jax_num_cpu_devices", 2)  # before anything is computed; GPUs ignore it
ball = jd.Shape(jd.shapes.sphere(2, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse((0.8, 0.5, 0.3)))
floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
film = jd.Film(32, 32)
eyes = [(4 * jnp.cos(a), 4 * jnp.sin(a), 2.5) for a in jnp.linspace(0.0, 6.0, 8)]
poses = jnp.stack([jd.look_at(eye, (0, 0, 0.5), (0, 0, 1)) for eye in eyes])
scene = jd.Scene(
    shapes={"ball": ball, "floor": floor},
    camera=jd.Perspective(poses[0], fov=35.0, film=film),
    environment=jd.ConstantEnvironment(1.0),
)
vertices = scene.parameters()["ball.vertices"]
tracer = jd.PathTracer(max_depth=2)


def loss(offset, pose, key):
    moved = scene.replace({"ball.vertices": vertices + offset, "camera.to_world": pose})
    return jnp.mean(jd.render(moved, key, spp=4, integrator=tracer) ** 2)


def of_device(offset, poses, keys):
    """What one device does: its views, one after the other; then the mean over all devices."""

    def mean_loss(offset):
        return jax.lax.map(lambda view: loss(offset, *view), (poses, keys)).mean()

    # `offset` is the same on all devices, so its gradient is the sum over them. JAX adds it up.
    value, gradient = jax.value_and_grad(mean_loss)(offset)
    return jax.lax.pmean(value, "views"), gradient / jax.device_count()


mesh = jax.make_mesh((jax.device_count(),), ("views",), axis_types=(AxisType.Auto,))
shared, divided = PartitionSpec(), PartitionSpec("views")
step = jd.jit(jax.shard_map(of_device, mesh=mesh, in_specs=(shared, divided, divided), out_specs=(shared, shared)))

keys = jax.random.split(jax.random.key(0), len(poses))
poses, keys = (jax.device_put(x, NamedSharding(mesh, divided)) for x in (poses, keys))
value, gradient = step(jnp.asarray([0.1, 0.0, 0.0]), poses, keys)
print(f"{jax.device_count()} devices: loss {value:.4f}, gradient {gradient}")
