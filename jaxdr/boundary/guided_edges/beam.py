"""What boundary segments add to the film: source's radiance x detector's importance x displacement of the edge.

For a fixed film point q the boundary term is the integral of f V dl along the silhouettes, on the sphere of directions
at the first hit x_D. Here f = f_s |cos_D| L, and V is the angular velocity of the silhouette relative to x_S. Over all
film points this becomes an integral over the points x_B on edges and the directions w_B there. Let d and D be the
distances from x_D to x_B and x_S, t the edge's direction, and m the unit normal of the plane through edge and line,
towards the faces. Then

    dq = (dq / dA) dA_D,    dA_D |cos_D| / d^2 = dw_B,    dl = |t x w_B| dx_B / d,
    V d = m . (x_B' - (1 - d/D) x_D' - (d/D) x_S'),

and all distances cancel:

    I' = integral of h(q) (dq / dA) f_s L |t x w_B| V d  dw_B dx_B

(f_s without its cosine). If more bounces lie between x_D and the camera, the importance of x_D replaces h dq / dA, and
x_D is a material point. If x_D is the first hit, x_D' depends on the form: x_D moves with the material, slides along
the fixed camera ray, or does a mixture of both.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.guided_edges.boundary_segments import BoundaryEnds, BoundarySegments
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes
from jaxdr.boundary.shared.kinds import any_above, glossy_at, lobes_along
from jaxdr.boundary.shared.path_segments import on_face
from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, norm, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.connections import ends, with_camera
from jaxdr.transport.interaction import on_fixed_ray
from jaxdr.transport.near_field import footprint
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form
from jaxdr.transport.sampler import path_numbers
from jaxdr.transport.subpaths import Subpath, trace_on


class Detected(NamedTuple):
    """Detector subpaths of n segments as the camera sees them, by the number of bounces before the camera: [B, n, ...].

    `value`: what the film receives per square pixel, per radiance of the source; zero if the camera does not see the
    subpath. `lobe`: numbers among `kinds.LOBES`, None once they have been looked at. Detached.
    """

    value: Float[Array, "B n 3"]
    film_point: Float[Array, "B n 2"]
    lens: Float[Array, "n 2"] | None
    lobe: Int[Array, "B n"] | None = None


def detect(
    packed: PackedScene,
    drawn: BoundarySegments,
    ends_of: BoundaryEnds,
    weight: Float[Array, " n"],
    number: Int[Array, " n"],
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Detected:
    """Connect detector ends with the camera, directly and after up to `max_depth` - 2 bounces (adjoint BSDF sampling).

    `weight` multiplies the values; `number` and `key` choose the random numbers.
    """
    bounces = settings.max_depth - 1
    point = ends_of.detector._replace(valid=ends_of.valid)
    cosine = jnp.abs(dot(point.normal, drawn.towards))
    _, _, width, height = packed.camera.film.window
    throughput = safe_divide(drawn.sine * weight * (width * height), cosine, cosine > 0)
    throughput = jnp.where(ends_of.valid & (cosine > 0), throughput, 0.0)
    start = Subpath(
        point=point,
        back=drawn.towards,
        throughput=jnp.broadcast_to(throughput[:, None], point.position.shape),
        density=jnp.ones_like(throughput),
        shorter=jnp.zeros_like(throughput),
        joined=None,
    )
    key_steps, key_lens = jax.random.split(key)
    u = [path_numbers(key_steps, number, b, throughput.dtype)[:, :2] for b in range(bounces - 1)]
    steps = jnp.stack(u) if u else jnp.zeros((0, number.shape[0], 2), throughput.dtype)
    subpath = trace_on(packed, start, steps, True, 1, settings.rays)
    lens = path_numbers(key_lens, number, 0, throughput.dtype)[:, :2] if packed.camera.aperture else None
    every_lens = None if lens is None else jnp.tile(lens, (bounces, 1))
    joined, film_point = with_camera(packed, ends(packed, subpath, bounces), every_lens, 1)
    carries = (joined.value != 0).any(-1)
    reach = jnp.where(carries, 1.0, 0.0).astype(throughput.dtype)
    offset = joined.end - joined.start
    seen = carries & ~queries.occluded(packed.geometry, queries.Rays(joined.start, offset, reach), settings.rays)
    value = jnp.where(seen[:, None], joined.value, 0.0).reshape(bounces, -1, 3)
    # Behind the first vertex the camera is reached over the others.
    glossy = glossy_at(packed, subpath.point.face)
    over = any_above(jnp.roll(glossy, -1, axis=0))
    lobe = lobes_along(jnp.broadcast_to(glossy[:1], glossy.shape), over)
    return Detected(value, film_point.reshape(bounces, -1, 2), lens, lobe)


def moves(
    packed: PackedScene, moving: Bool[Array, " S"], lunes: EdgeLunes, drawn: BoundarySegments, ends_of: BoundaryEnds
) -> Bool[Array, " n"]:
    """Whether anything that bounds a segment moves."""
    shape = packed.face_shape
    edge = moving[packed.edges.shape[lunes.edge[drawn.point.row]]]
    source = jnp.where(ends_of.source.valid, moving[shape[ends_of.source.face]], packed.environment_turns)
    return edge | source | moving[shape[ends_of.detector.face]]


def image(
    packed: PackedScene,
    lunes: EdgeLunes,
    drawn: BoundarySegments,
    ends_of: BoundaryEnds,
    seen: Detected,
    radiance: Float[Array, "B n 3"],
    form: Form,
) -> Float[Array, "H W 3"]:
    """Image of the segments' contributions: zero in value, right in derivative.

    `radiance` is what the sources send over the density of the segments, for every number of bounces of the detector
    subpath. `form` is that of the first hits; see `primary_samples`.
    """
    film = packed.camera.film
    whole, first = _displacements(packed, lunes, drawn, ends_of, seen, form)
    total = splat(film, seen.film_point[0], scale(seen.value[0] * radiance[0], first))
    if radiance.shape[0] > 1:
        values = scale(seen.value[1:] * radiance[1:], whole)
        total += splat(film, seen.film_point[1:].reshape(-1, 2), values.reshape(-1, 3))
    return total


def _displacements(
    packed: PackedScene, lunes, drawn: BoundarySegments, ends_of: BoundaryEnds, seen: Detected, form: Form
):
    """(V d if the detector is a material point, V d if it is a first hit of this form), zero in value."""
    detector, source = ends_of.detector, ends_of.source
    near = norm(detector.position - drawn.position)
    length = jnp.where(source.valid, norm(source.position - detector.position), 1.0)
    share = jnp.where(source.valid, safe_divide(near, length), 0.0)
    moved = dot(drawn.pole, drawn.point.moving(packed, lunes))
    moved -= share * dot(drawn.pole, on_face(packed, source.face, source.barycentric))
    if packed.environment_turns:
        moved -= jnp.where(source.valid, 0.0, near * dot(drawn.pole, packed.turned(drawn.towards)))
    at_detector = dot(drawn.pole, on_face(packed, detector.face, detector.barycentric))
    whole = moved - (1 - share) * at_detector
    if form == Form.MATERIAL:
        first = whole
    else:
        view = packed.camera.view(seen.lens)
        origin, direction = view.rays(seen.film_point[0])
        face = jnp.where((seen.value[0] != 0).any(-1), detector.face, -1)
        sliding = on_fixed_ray(packed, jnp.broadcast_to(origin, direction.shape), direction, face)
        at_first = dot(drawn.pole, sliding.position)
        if form == Form.NEAR:
            size = footprint(stop_gradient(view), detector.position, detector.normal)
            near_share = jnp.where(source.valid, size.share(length**2), 0.0)
            at_first = (1 - near_share) * at_first + near_share * at_detector
        first = moved - (1 - share) * at_first
    return whole - stop_gradient(whole), first - stop_gradient(first)
