"""The camera's segment with warped areas (Xu et al. 2023): `PathTracer(primary="warp")`.

First hits are material points, and what no surface covers stays fixed on the film; over both, f is the pixel filter
times what is sent to the camera, as in `warped_area`, with the camera for the apex. So the boundary of what the camera
sees is that of occlusion alone, and no edge is looked for.
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
from jaxdr.transport.path import PathRecord, PathSettings
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
        'render: silhouettes of what lights without area light up have no derivative with primary="warp"; take '
        'lights with an area, or primary="fixed_ray"'
    )


class WarpedCamera:
    """Term of the camera's segment, by the estimator of those behind the first hit."""

    name = "warp"
    refusals = (
        Refusal("parallel cameras", '`Perspective`, `ThinLens`, `primary="fixed_ray"`', _camera),
        Refusal("lights without area", 'lights with an area, `primary="fixed_ray"`', _lights),
    )

    def __init__(self, warp: WarpedArea):
        self.warp = warp

    def prepare(self, context: Context, key: PRNGKeyArray) -> Faces | None:
        """Raises ValueError for what it does not know."""
        if not any(context.moving.seen):
            return None
        packed = context.packed
        refuse(self.refusals, Asked(packed, context.settings))
        return self.warp.prepare(context, key)

    def draw(self, context: Context, state: Faces, chunk: Chunk, key: PRNGKeyArray):
        """Nothing: what the paths found is differentiated."""
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

    `faces` are what `warp.prepare` found; `primary` is in material form, under a smooth filter.
    """
    fixed, fixed_view = stop_gradient((packed, primary.view))
    ends = _ends(fixed, fixed_view, primary)
    f = _measure(fixed, fixed_view, record, ends)
    value = f(ends.target)
    lit = (value != 0).any(-1)
    # A camera lies in no face that could hide anything.
    around = warp.around(fixed, True, fixed.environment is not None, settings.rays)._replace(horizon=False)
    apex = _apex(fixed, fixed_view, ends)
    velocities = hidden_velocities(fixed, faces, apex, ends, lit, around, key)

    def moved(slot):
        row = velocities.row(slot)
        return _displacement(packed, primary.view.row(row), ends.infinite[row], velocities.seen(slot))

    return divergence_term(f, value, ends, lit, velocities, moved)


def _ends(packed: PackedScene, view: View, primary: PrimarySamples) -> SegmentEnds:
    """From the camera to first hits, or where there are none to the sphere around it; detached."""
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
        corners=packed.vertices[packed.faces[first.face]],
        infinite=missed,
    )


def _apex(packed: PackedScene, view: View, ends: SegmentEnds) -> SurfacePoint:
    """The camera in the form that `find_occluders` takes: in a plane behind everything that it sees."""
    count = ends.infinite.shape[0]
    ones = jnp.ones(count, ends.apex.dtype)
    forward = jnp.broadcast_to(normalize(view.matrix[:, 2]), ends.apex.shape)
    third = jnp.full_like(ends.apex, 1 / 3)
    return SurfacePoint(ends.infinite | True, ends.apex_face, third, ends.apex, forward, forward, ones, 0.0 * ones)


def _measure(packed: PackedScene, view: View, record: PathRecord, ends: SegmentEnds) -> Measure:
    """Pixel filter x film per area (on the sphere: of it) x radiance towards the camera, over the samples' density.

    The density is that of the filter: of the first two factors only their change is left.
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
    """Of N samples, those of a pixel in a row, as `primary_samples` has them."""
    x0, y0, width, height = view.film.window
    row, column = jnp.divmod(jnp.arange(count) // (count // (width * height)), width)
    return jnp.stack([column + x0, row + y0], -1) + 0.5


def _displacement(packed: PackedScene, view: View, far: Bool[Array, " C"], seen: Hidden) -> Float[Array, "C 3"]:
    """As `divergence.displacement`, seen from a camera: on the sphere, points that are fixed on the film stay."""
    apex = jnp.broadcast_to(view.position, seen.position.shape)
    moved = displacement(packed, apex, jnp.zeros_like(far), seen)
    if packed.environment is None:
        return moved
    offset = seen.position - stop_gradient(apex)
    before = packed.vertices[packed.faces[seen.occluder]]
    towards = normalize(interpolate(before, seen.on_occluder) - apex)
    still = view.rays(stop_gradient(view.project(seen.position)))[1]
    on_sphere = scale(towards - still, norm(offset))
    return jnp.where(far[:, None], on_sphere - stop_gradient(on_sphere), moved)
