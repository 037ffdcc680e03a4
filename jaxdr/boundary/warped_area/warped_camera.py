"""The camera's segment with warped areas (Xu et al. 2023): `PathTracer(primary="warp")`.

First hits are material points. Film points that no surface covers stay fixed. Over both, f is the pixel filter times
the radiance towards the camera. The method is that of `warped_area`, with the camera as the apex. So boundaries come
from occlusion only, and no search for edges is needed.
"""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxdr.boundary.shared.face_neighbours import Faces
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.shared.refusals import Asked, Refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.warped_area.divergence import Hidden, Measure, displacement, divergence_term, hidden_velocities
from jaxdr.boundary.warped_area.estimator import Onward, WarpedArea, sent_back
from jaxdr.geometry.vector import interpolate, norm, normalize, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.camera import View
from jaxdr.scene.camera.pinhole import PinholeCamera
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted
from jaxdr.transport.interaction import SurfacePoint, on_fixed_ray
from jaxdr.transport.path import PathRecord
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.shading import Scatterer


def _camera(asked: Asked) -> str | None:
    camera = asked.packed.camera
    if isinstance(camera, PinholeCamera):
        return None
    return (
        f'render: primary="warp" needs a camera with a position, not {type(camera).__name__}; take a '
        'Perspective or a ThinLens, or primary="fixed_ray"'
    )


def _lights(asked: Asked) -> str | None:
    if not asked.packed.light_count:
        return None
    return (
        'render: silhouettes of surfaces that lights without area light up have no derivative with primary="warp"; '
        'take lights with an area, or primary="fixed_ray"'
    )


class WarpedCamera:
    """Term of the camera's segment, by the estimator for segments behind the first hit."""

    name = "warp"
    refusals = (
        Refusal("parallel cameras", '`Perspective`, `ThinLens`, `primary="fixed_ray"`', _camera),
        Refusal("lights without area", 'lights with an area, `primary="fixed_ray"`', _lights),
    )

    def __init__(self, warp: WarpedArea):
        self.warp = warp

    def prepare(self, context: Context, key: PRNGKeyArray) -> Faces | None:
        """State of the estimator; None if nothing moves. Raises ValueError for what is not covered."""
        if not any(context.moving.seen):
            return None
        packed = context.packed
        refuse(self.refusals, Asked(packed, context.settings))
        return self.warp.prepare(context, key)

    def draw(self, context: Context, state: Faces, chunk: Chunk, key: PRNGKeyArray):
        """No requests: the term differentiates the contributions that the paths found."""
        return None, key

    def image(self, context: Context, state: Faces, chunk: Chunk, held, answers) -> Float[Array, "H W 3"]:
        """The term of all paths."""
        packed, primary, record = context.packed, chunk.primary, chunk.record
        return chunk.image(
            packed, warped_camera_term(packed, state, self.warp, primary, record, held, context.settings)
        )


def warped_camera_term(
    packed: PackedScene,
    faces: Faces,
    warp: WarpedArea,
    primary: PrimarySamples,
    record: PathRecord,
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Float[Array, "N 3"]:
    """Boundary term of the camera's segments of N paths: zero in value, right in derivative.

    `faces` is the result of `warp.prepare`. `primary` is in material form, with a smooth filter.
    """
    fixed, fixed_view = stop_gradient((packed, primary.view))
    ends = _ends(fixed, fixed_view, primary)
    f = _measure(fixed, fixed_view, record, ends)
    value = f(ends.target)
    lit = (value != 0).any(-1)
    # The camera lies in no face, so no face's plane hides anything.
    around = warp.around(fixed, True, fixed.environment is not None, settings.rays)._replace(horizon=False)
    apex = _apex(fixed, fixed_view, ends)
    velocities = hidden_velocities(fixed, faces, apex, ends, lit, around, key)

    def moved(slot):
        row = velocities.row(slot)
        return _displacement(packed, primary.view.row(row), ends.infinite[row], velocities.seen(slot))

    return divergence_term(f, value, ends, lit, velocities, moved)


def _ends(packed: PackedScene, view: View, primary: PrimarySamples) -> SegmentEnds:
    """Segments from the camera to first hits, or to a sphere around the camera on a miss; detached."""
    first, direction = stop_gradient((primary.first, primary.direction))
    apex = jnp.broadcast_to(view.position, direction.shape)
    missed = ~first.valid
    far = missed[:, None]
    return SegmentEnds(
        apex=apex,
        apex_face=jnp.zeros_like(first.face),
        target=jnp.where(far, apex + packed.size * direction, first.position),
        normal=jnp.where(far, direction, first.normal),
        face=first.face,
        corners=packed.corners_of(first.face),
        infinite=missed,
    )


def _apex(packed: PackedScene, view: View, ends: SegmentEnds) -> SurfacePoint:
    """The camera as a surface point for `find_occluders`: in a plane behind everything that it sees."""
    count = ends.infinite.shape[0]
    ones = jnp.ones(count, ends.apex.dtype)
    forward = jnp.broadcast_to(normalize(view.matrix[:, 2]), ends.apex.shape)
    third = jnp.full_like(ends.apex, 1 / 3)
    return SurfacePoint(ends.infinite | True, ends.apex_face, third, ends.apex, forward, forward, ones, 0.0 * ones)


def _measure(packed: PackedScene, view: View, record: PathRecord, ends: SegmentEnds) -> Measure:
    """Pixel filter x film area per surface area (or sphere area) x radiance towards the camera, over the samples' pdf.

    The pdf is that of the filter. So the first two factors over the pdf are one in value; only their derivative counts.
    """
    count = ends.infinite.shape[0]
    far = ends.infinite[:, None]
    centre = _pixel_centres(view, count)
    parts: list[Onward] = []
    for segments in (record.direct, record.scattered):
        if segments is not None:
            first = jax.tree.map(lambda a: a[0], segments)
            parts.append((first, jnp.arange(count), first.visible))

    def importance(position):
        normal = jnp.where(far, normalize(position - ends.apex), ends.normal)
        local = view.local(position)
        return view.film.filter.pdf(view.project_local(local) - centre) * view.film_area(local, normal)

    detached = stop_gradient(importance(ends.target))
    seen = detached > 0
    inverse = safe_divide(1.0, detached, seen, 0.0)

    def measure(position):
        towards = normalize(position - ends.apex)
        point = on_fixed_ray(packed, position, ends.normal, jnp.where(ends.infinite, -1, ends.face))
        radiance = emitted(packed, point, -towards)
        if parts:
            back = sent_back(packed, Scatterer(packed, point, -towards), parts)
            radiance += jnp.where(far, 0.0, back)
        return scale(radiance, importance(position) * inverse)

    return measure


def _pixel_centres(view: View, count: int) -> Float[Array, "N 2"]:
    """Pixel centres of N samples, in the order of `primary_samples`: the samples of a pixel are in a row."""
    x0, y0, width, height = view.film.window
    row, column = jnp.divmod(jnp.arange(count) // (count // (width * height)), width)
    return jnp.stack([column + x0, row + y0], -1) + 0.5


def _displacement(packed: PackedScene, view: View, far: Bool[Array, " C"], seen: Hidden) -> Float[Array, "C 3"]:
    """Like `divergence.displacement`, from a camera. On the sphere, points that are fixed on the film do not move."""
    apex = jnp.broadcast_to(view.position, seen.position.shape)
    moved = displacement(packed, apex, jnp.zeros_like(far), seen)
    if packed.environment is None:
        return moved
    offset = seen.position - stop_gradient(apex)
    before = packed.corners_of(seen.occluder)
    towards = normalize(interpolate(before, seen.on_occluder) - apex)
    still = view.rays(stop_gradient(view.project(seen.position)))[1]
    on_sphere = scale(towards - still, norm(offset))
    return jnp.where(far[:, None], on_sphere - stop_gradient(on_sphere), moved)
