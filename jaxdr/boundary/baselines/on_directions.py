"""Direct light as an integral over directions, warped by a velocity field on them: what its users share.

At a shading point y the integrand of direct light is a function of the direction w: F(w) = L(y, w) f_s(w) cos (Xu et
al. 2023, Eq. 55). It jumps at the silhouettes of occluders and at all outlines of the emitter itself. (In the material
form, Eq. 56, these outlines are fixed on the surface.) Let v be a continuous field on the sphere that tends to the
velocity of these curves as a direction approaches them. Then

    dI/d theta = int [dF/d theta at a fixed direction + div (F v)] d sigma.

`render`'s interior term is in material form: its directions follow the emitter's points, with a velocity m. So it is
int [dF/d theta + div (F m)] d sigma, point by point. This file adds div (F v) - div (F m), which is a warp by v - m.
The sum is the spherical estimator, at the path tracer's own emitter samples.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.shared.path_segments import PathSegments, SegmentEnds, path_segments
from jaxdr.boundary.shared.refusals import Asked, Refusal
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.warped_area.divergence import Measure, Velocities, displacement, divergence_term
from jaxdr.geometry.vector import dot, norm, normalize, scale, triangle_normals
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import environment_radiance
from jaxdr.transport.interaction import SurfacePoint

# Velocities around the targets of N segments, which are directions: `infinite`, at the distance one from the apex.
# Arguments: the detached scene, apexes, ends, which segments carry light, and a key.
VelocityField = Callable[[PackedScene, SurfacePoint, SegmentEnds, Bool[Array, " N"], PRNGKeyArray], Velocities]


def direct_light_refusals(name: str) -> tuple[Refusal, ...]:
    """What warps of directions do not cover."""

    def indirect(asked: Asked) -> str | None:
        depth = asked.settings.max_depth
        if depth <= 2:
            return None
        return f"{name}: direct light only, but max_depth is {depth}; set max_depth=2, or take WarpedArea"

    def glow(asked: Asked) -> str | None:
        if asked.packed is None or not asked.packed.glow:
            return None
        return (
            f"{name}: emitters with textures are not covered: seams of a texture are jumps on the sphere that "
            "move; take emitters of one radiance, or WarpedArea"
        )

    return (
        Refusal("`max_depth` above 2", "`max_depth=2`, `WarpedArea`", indirect),
        Refusal("emitters with textures", "emitters of one radiance, `WarpedArea`", glow),
    )


def warped_directions(context: Context, chunk: Chunk, field: VelocityField, key: PRNGKeyArray) -> Float[Array, "N 3"]:
    """The term of direct light, one value a path: zero in value, with the derivative div (F v) - div (F m)."""
    packed, record = context.packed, chunk.record
    if record.direct is None or not (packed.has_area_emitters or packed.environment is not None):
        return jnp.zeros_like(record.radiance)
    fixed = jax.tree.map(stop_gradient, packed)
    paths = path_segments(packed, chunk, "direct")
    index = jnp.arange(paths.paths)
    measure = _measure(fixed, paths, index)
    ends = paths.ends(index)
    away = ends.target - ends.apex
    reach = norm(away)
    reach = jnp.where(reach > 0, reach, 1.0)
    towards = jnp.where(ends.infinite[:, None], packed.turned(paths.table.direction), scale(away, 1.0 / reach))
    plane = triangle_normals(ends.corners)
    normal, area = normalize(plane), norm(plane)
    there = area > 0
    ratio = jnp.where(there, area, 1.0) / stop_gradient(jnp.where(there, area, 1.0))
    # Solid angle per area of the emitter's reference surface.
    angle = jnp.where(ends.infinite, 1.0, jnp.abs(dot(normal, towards)) / reach**2 * ratio)
    lit = paths.table.visible & (scale(measure(stop_gradient(towards)), angle) != 0).any(-1)

    # The derivative of `along` is div (F m), as the emitter's points move. The interior term has it; subtract it.
    along = jnp.where(lit[:, None], scale(measure(towards), angle), 0.0)
    towards, angle = stop_gradient((towards, angle))

    def f(direction):
        return scale(measure(direction), angle)

    warp = _warp(paths, f, towards, lit, field, key)
    return warp - (along - stop_gradient(along))


def _warp(paths: PathSegments, f: Measure, towards, lit, field: VelocityField, key) -> Float[Array, "N 3"]:
    """div (F v) = F div v + grad F . v at unit directions `towards`, summed over the auxiliary ones."""
    index = jnp.arange(paths.paths)
    apex = paths.fixed.apex(index)
    count, everywhere = paths.paths, jnp.ones(paths.paths, bool)
    ends = SegmentEnds(
        apex=apex.position,
        apex_face=apex.face,
        target=apex.position + towards,
        normal=towards,
        face=jnp.zeros(count, jnp.int32),
        corners=jnp.zeros((count, 3, 3), towards.dtype),
        infinite=everywhere,
    )
    velocities = field(paths.fixed.packed, apex, ends, lit, key)

    def moved(slot):
        row = velocities.row(slot)
        # No turns here: a turn of the environment is already in F.
        return displacement(paths.packed, paths.position(row), everywhere[row], velocities.seen(slot), turns=False)

    # On the unit sphere the direction itself is the target, relative to the apex.
    around_apex = dataclasses.replace(ends, target=towards)
    return divergence_term(f, f(towards), around_apex, lit, velocities, moved)


def _measure(packed: PackedScene, paths: PathSegments, index: Int[Array, " N"]) -> Measure:
    """F / pdf (per area) of emitter samples, as a function of the unit direction at the apex; all else is detached."""
    scatterer, table = paths.scatterer(index), paths.table

    def measure(towards):
        weight = table.weight[index]
        if table.unlit is not None and packed.has_varying_sky:
            sky = environment_radiance(packed, towards)
            weight = jnp.where(table.infinite[index][:, None], table.unlit[index] * sky, weight)
        return weight * scatterer.eval(normalize(towards))

    return measure
