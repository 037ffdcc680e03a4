"""Where the time of a forward image goes: the pieces of one bounce are timed as programs of their own.

Their inputs are those of the path tracer: a block of first hits that scatter, and the directions, emitter samples and
hits that follow from them.
"""

import statistics

import jax
import jax.numpy as jnp

import jaxdr as jd
from experiments import common
from jaxdr.geometry import queries
from jaxdr.scene.packed import pack
from jaxdr.transport.emission import emitted, emitter_pdf, radiance_towards, sample_emitter
from jaxdr.transport.interaction import detached_barycentric, intersect, leave, material_point
from jaxdr.transport.path import trace_paths
from jaxdr.transport.primary import Form, primary_samples
from jaxdr.transport.radiance import CPU_BLOCK as BLOCK
from jaxdr.transport.radiance import arriving_radiance
from jaxdr.transport.sampler import uniform
from jaxdr.transport.shading import Scatterer

CALLS = 5
RAYS = "auto"


def pieces(scene, settings, samples):
    """(name -> seconds a path or, but for the first and last, a vertex; vertices that scatter, a path).

    From all pixels with `samples` samples each.
    """
    key = jax.random.key(0)
    packed = jd.jit(pack)(scene)
    _, _, width, height = scene.camera.film.window
    count = width * height * samples
    state = {}

    def timed(name, function, *arguments, each=BLOCK):
        program = jd.jit(function)
        answer = jax.block_until_ready(program(*arguments))
        seconds = [common.seconds_of(program, *arguments)[1] for _ in range(CALLS)]
        state[name] = statistics.median(seconds) / each
        return answer

    def camera(packed):
        return primary_samples(packed, jnp.arange(samples), key, RAYS, Form.FIXED)

    primary = timed("camera rays, their hits", camera, packed, each=count)
    vertices = jd.jit(lambda packed: _vertices(packed, primary, key, settings))(packed)
    rows = jnp.resize(jnp.flatnonzero(primary.first.valid), BLOCK)
    point, wi, u = jax.tree.map(lambda x: x[rows], (primary.first, -primary.direction, uniform(key, (count, 4))))

    emitter = timed("emitter samples", lambda packed, u: sample_emitter(packed, u[:, :2]), packed, u)

    def towards(emitter, point):
        offset = emitter.point.position - point.position
        unit = offset / jnp.maximum(jnp.linalg.norm(offset, axis=-1, keepdims=True), 1e-20)
        return jnp.where(emitter.infinite[:, None], emitter.direction, unit)

    to_light = towards(emitter, point)

    def shadow(packed, emitter, point, to_light):
        scatterer = Scatterer(packed, point, wi)
        start = scatterer.leave(to_light)
        far = start + 2.0 * packed.size * to_light
        end = jnp.where(emitter.infinite[:, None], far, leave(emitter.point, -to_light))
        return queries.occluded(packed.geometry, queries.Rays(start, end - start, point.valid * 1.0), RAYS)

    timed("shadow rays", shadow, packed, emitter, point, to_light)

    def evaluate(packed, point, wi, emitter, to_light):
        scatterer = Scatterer(packed, point, wi)
        light = radiance_towards(packed, emitter, to_light)
        return scatterer.eval(to_light) * light, scatterer.pdf(to_light)

    timed("BSDF values and densities", evaluate, packed, point, wi, emitter, to_light)

    def sample(packed, point, wi, u):
        scatterer = Scatterer(packed, point, wi)
        wo = scatterer.sample(u[:, 2:])
        if packed.has_delta_lobes:
            delta = scatterer.sample_delta(u[:, 2:])
            wo = jnp.where(delta.probability[:, None] > 0, delta.wo, wo)
        return wo, scatterer.pdf(wo), scatterer.leave(wo)

    wo, pdf, start = timed("BSDF samples", sample, packed, point, wi, u)
    active = point.valid & (pdf > 0)
    face = timed("scattered rays", lambda packed: intersect(packed, start, wo, active, RAYS).face, packed)

    def arrive(packed, face):
        hit = face >= 0
        inside = jnp.where(hit, face, 0)
        return material_point(packed, inside, detached_barycentric(packed, start, wo, inside), hit)

    following = timed("vertices at the hits", arrive, packed, face)

    def found(packed, following):
        offset = following.position - point.position
        cosine = jnp.abs((following.normal * wo).sum(-1))
        density = emitter_pdf(packed, following, wo, (offset**2).sum(-1), cosine)
        return emitted(packed, following, -wo), density

    timed("emission that is hit, its density", found, packed, following)

    def whole(packed):
        primary = camera(packed)
        return arriving_radiance(packed, primary.first, primary.direction, primary.u, key, settings)

    timed("all of it", whole, packed, each=count)
    return state, float(vertices)


def _vertices(packed, primary, key, settings):
    """Mean number of vertices of a path that scatter."""
    record = trace_paths(packed, primary.first, primary.direction, primary.u, key, settings)
    return (record.direct.throughput > 0).any(-1).sum(0).mean()


def report(scene, settings, samples):
    """Rows of the table, seconds and share of a million paths: pieces of a vertex times the vertices of a path."""
    seconds, vertices = pieces(scene, settings, samples)
    whole = seconds.pop("all of it")
    rows = []
    for name, value in seconds.items():
        total = value * (1 if name.startswith("camera") else vertices)
        rows.append({"piece": name, "seconds": total * 1e6, "share": total / whole})
    rows.append({"piece": "sum", "seconds": sum(r["seconds"] for r in rows), "share": sum(r["share"] for r in rows)})
    rows.append({"piece": "all in one program", "seconds": whole * 1e6, "share": 1.0})
    return rows, vertices
