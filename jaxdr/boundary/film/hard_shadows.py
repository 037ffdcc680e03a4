"""Hard shadows of lights without area: lines in the image, and lines on the surfaces that paths meet.

No path and no kernel meets a light that is a point or a direction. So its shadows are drawn from what bounds them: a
random point on a silhouette as the light sees it, and the ray past that point to the receiver. The jump there is the
light's own contribution. A light that ends abruptly (a projected image) has a border, which is used like a silhouette.

With the camera ray fixed, the direct light of first hits has line integrals of jump x normal velocity over the film,
like silhouettes. For light that the receiver scatters on, the line is on the receiver. Path vertices are connected to
points on it, like to emitters; the line's velocity counts relative to the material point there.
"""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxdr.boundary.film.shadow_lines import (
    OnFilm,
    ShadowDistribution,
    ShadowPoints,
    draw_lines,
    on_film,
    shadow_distribution,
    shadow_points,
)
from jaxdr.boundary.shared.path_segments import PathSegments
from jaxdr.boundary.shared.refusals import INTERIOR, Asked, Refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.geometry import queries
from jaxdr.geometry.vector import (
    cross,
    dot,
    normalize,
    scale,
)
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.camera import Perspective
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.interaction import leave, material_point
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form

SAME_SURFACE = 0.7  # smallest cosine between the normals of faces that count as one surface


def _camera(asked: Asked) -> str | None:
    camera = asked.packed.camera
    if isinstance(camera, Perspective):
        return None
    return (
        f"render: hard shadows seen by a {type(camera).__name__} camera have no derivative yet; "
        f"take a Perspective, {INTERIOR}"
    )


class HardShadows:
    """Term of the edges of hard shadows, in the image and on what paths meet."""

    name = "shadows"
    refusals = (Refusal("cameras other than `Perspective`", "`Perspective`", _camera),)

    def prepare(self, context: Context, key) -> ShadowDistribution | None:
        """Distribution of shadow lines; None without lights. Raises ValueError for cameras that are not covered."""
        del key
        packed, moving = context.packed, context.moving
        if not packed.light_count or context.settings.max_depth == 1:
            return None
        refuse(self.refusals, Asked(packed, context.settings))
        lights = moving.lights or (False,) * packed.light_count
        return shadow_distribution(packed, moving.seen, lights, context.settings)

    def draw(self, context: Context, state: ShadowDistribution, chunk: Chunk, key):
        """No requests: the jump is the light's own contribution, which needs no path."""
        return None, jax.random.split(key)

    def image(self, context: Context, state: ShadowDistribution, chunk: Chunk, held, answers) -> Float[Array, "H W 3"]:
        """Draw points on silhouettes as lights see them, and follow them to the film and to the paths' vertices."""
        packed, settings = context.packed, context.settings
        count = max(1, round(chunk.paths * context.edge_samples))
        total = chunk.share * film_shadow_term(packed, state, count, held[0], settings, context.form)
        if settings.max_depth > 2 and chunk.record.direct is not None:
            paths = PathSegments(packed, chunk.primary, chunk.record.direct)
            total += chunk.image(packed, scattered_shadow_term(packed, state, paths, held[1], settings))
        return total


def film_shadow_term(
    packed: PackedScene,
    distribution: ShadowDistribution,
    count: int,
    key: PRNGKeyArray,
    settings: PathSettings,
    form: Form,
) -> Float[Array, "H W 3"]:
    """Edges of hard shadows in the image, from `count` points on silhouettes: zero in value, right in derivative.

    `form` is that of the first hits; see `primary_samples`.
    """
    detached = jax.tree.map(stop_gradient, packed)
    lines, weight = draw_lines(packed, distribution.film, count, key)
    points = shadow_points(packed, lines, settings)
    seen = on_film(packed, points)
    visible = _visible(detached, points, seen, settings)
    wi = normalize(detached.camera.to_world[:3, 3] - points.point.position)
    # From the lit side to the dark side the image loses the light's own contribution.
    jump = scale(points.scattered(detached, wi), -weight / count)
    goes = seen.film_point
    if form == Form.MATERIAL:
        material = material_point(packed, points.point.face, points.point.barycentric, points.point.valid)
        ahead = detached.camera.to_world[:3, 3] + detached.camera.to_world[:3, 2]
        goes = goes - packed.camera.project(jnp.where(seen.inside[:, None], material.position, ahead))
    displacement = dot(seen.across, goes - stop_gradient(goes))
    value = scale(jnp.where(visible[:, None], jump, 0.0), displacement)
    return splat(packed.camera.film, seen.film_point, value)


def _visible(detached: PackedScene, points: ShadowPoints, seen: OnFilm, settings) -> Bool[Array, " n"]:
    """Whether the camera sees the receiver on both sides of the shadow's edge."""
    film, point = detached.camera.film, points.point
    step = 1e-5 * max(film.width, film.height)
    aside = step * normalize(seen.across)
    visible = seen.inside
    for side in (1.0, -1.0):
        origin, direction = detached.camera.rays(stop_gradient(seen.film_point) + side * aside)
        origin = jnp.broadcast_to(origin, direction.shape)
        reach = jnp.where(visible, 1e30, 0.0).astype(direction.dtype)
        hit = queries.closest_hit(detached.geometry, queries.Rays(origin, direction, reach), settings.rays)
        slope = dot(point.normal, direction)
        expected = safe_divide(dot(point.normal, point.position - origin), slope)
        normal = normalize(detached.face_normals()[jnp.maximum(hit.face, 0)])
        close = jnp.abs(hit.t - expected) < 1e-4 * jnp.abs(expected)
        same = (hit.face == point.face) | (close & (dot(normal, point.normal) > SAME_SURFACE))
        visible = visible & (hit.face >= 0) & same
    return visible


def scattered_shadow_term(
    packed: PackedScene,
    distribution: ShadowDistribution,
    paths: PathSegments,
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Float[Array, "N 3"]:
    """Edges of hard shadows on surfaces that light up the vertices of N paths: zero in value, right in derivative.

    Every vertex but the last is connected to one point on the edge of a shadow. `paths` are emitter connections.
    """
    detached = jax.tree.map(stop_gradient, packed)
    index = jnp.arange(paths.count - paths.paths)
    lines, weight = draw_lines(packed, distribution.scattered, index.shape[0], key)
    points = shadow_points(packed, lines, settings)
    point, scatterer = points.point, paths.scatterer(index)
    offset = point.position - scatterer.point.position
    distance2 = dot(offset, offset)
    distance2 = jnp.where(distance2 > 0, distance2, 1.0)
    towards = normalize(offset)
    geometry = jnp.abs(dot(point.normal, towards)) / distance2
    value = paths.table.throughput[index] * scatterer.eval(towards) * points.scattered(detached, -towards)
    value = scale(value, geometry * weight)
    visible = point.valid & (value != 0).any(-1)
    start = scatterer.leave(towards)
    beside = scale(normalize(points.lit), 4.0 * queries.BESIDE * point.scale)
    for side in (1.0, -1.0):
        end = leave(point, -towards) + side * beside
        reach = jnp.where(visible, 1.0, 0.0).astype(start.dtype)
        visible &= ~queries.occluded(detached.geometry, queries.Rays(start, end - start, reach), settings.rays)
    across = cross(point.normal, points.tangent)
    across = scale(across, jnp.sign(dot(across, points.lit)))
    material = material_point(packed, point.face, point.barycentric, point.valid)
    goes = points.position - material.position
    displacement = dot(across, goes - stop_gradient(goes))
    value = scale(jnp.where(visible[:, None], value, 0.0), -displacement)
    return jnp.zeros((paths.paths, 3), value.dtype).at[paths.path(index)].add(value)
