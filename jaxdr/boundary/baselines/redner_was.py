"""Warped areas on the sphere of directions (Bangaru et al. 2020; "Redner_WAS" in Xu et al. 2023), direct light only.

At a shading point y the integrand of direct light is a function of the direction w: F(w) = L(y, w) f_s(w) cos (Eq. 55).
It jumps at the silhouettes of occluders and at all outlines of the emitter itself. (In the material form, Eq. 56, these
outlines are fixed on the surface.) Let v be a continuous field on the sphere that tends to the velocity of these curves
as a direction approaches them. Then

    dI/d theta = int [dF/d theta at a fixed direction + div (F v)] d sigma.

`render`'s interior term is in material form: its directions follow the emitter's points, with a velocity m. So it is
int [dF/d theta + div (F m)] d sigma, point by point. This file adds div (F v) - div (F m), which is a warp by v - m.
The sum is the spherical estimator, at the path tracer's own emitter samples.
"""

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.shared.face_neighbours import Faces, connect_faces
from jaxdr.boundary.shared.path_segments import PathSegments, SegmentEnds, path_segments
from jaxdr.boundary.shared.refusals import Asked, Refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.warped_area.continuous_velocity import Convolution, Kernel
from jaxdr.boundary.warped_area.divergence import (
    Measure,
    Warped,
    WarpedTerm,
    check_options,
    displacement,
    divergence_term,
    hidden_velocities,
)
from jaxdr.geometry.vector import dot, norm, normalize, scale, triangle_normals
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import environment_radiance


def _indirect(asked: Asked) -> str | None:
    if asked.settings.max_depth <= 2:
        return None
    depth = asked.settings.max_depth
    return f"RednerWAS: direct light only, but max_depth is {depth}; set max_depth=2, or take WarpedArea"


def _glow(asked: Asked) -> str | None:
    if not asked.packed.glow:
        return None
    return (
        "RednerWAS: emitters with textures are not covered: seams of a texture are jumps on the sphere that "
        "move; take emitters of one radiance, or WarpedArea"
    )


class RednerWAS(WarpedTerm):
    """Direct light by warped areas on the sphere of directions (Xu et al. 2023, Eq. 55-57), for comparison.

    Each direction has the velocity of the material point that is seen in it, on the emitter or on what hides the
    emitter. Where nothing is seen the velocity is zero. The boundary-test function B is evaluated at the same point
    (Eq. 18). Every auxiliary direction costs one ray. Prefer `WarpedArea`: there the outlines of emitters do not move,
    and need no warp.

    All fields are static.

    - `distance`: "exponential" (Eq. 57), that of the original, or "path_space" (Eq. 16).
    - `normal_edges`: whether B vanishes at silhouettes that are edges between two faces, where the normal jumps. All
      outlines of a cube are such edges. If False, only cosines and open edges count, as Xu et al. found in the public
      implementation (Fig. 18). Then the velocity field does not reach the velocity of such an outline, and the
      derivative is wrong. Edges that are not outlines need no warp.
    - `sigma0`, `power`, `samples`, `boundary_power`, `debias`, `spread`: as in `WarpedArea`, but lengths are angles on
      the sphere, in radians.

    Take `PathTracer(max_depth=2, sampling="emitter")`. With "mis" the derivative is the same but noisier: a part of
    the interior term is then at BSDF samples, where div (F m) does not cancel.

    Raises ValueError for options out of range.
    """

    distance: Literal["path_space", "exponential"] = eqx.field(static=True, default="exponential")
    normal_edges: bool = eqx.field(static=True, default=True)
    sigma0: float = eqx.field(static=True, default=0.006)
    power: float = eqx.field(static=True, default=3.0)
    samples: int = eqx.field(static=True, default=8)
    boundary_power: float = eqx.field(static=True, default=3.0)
    debias: bool = eqx.field(static=True, default=True)
    spread: float = eqx.field(static=True, default=0.5)

    refusals = (
        Refusal("`max_depth` above 2", "`max_depth=2`, `WarpedArea`", _indirect),
        Refusal("emitters with textures", "emitters of one radiance, `WarpedArea`", _glow),
    )

    def __check_init__(self):
        check_options(self, ("samples",))

    def prepare(self, context: Context, key: PRNGKeyArray) -> Faces:
        """Normals and neighbours of all faces, once for a whole image. Raises ValueError for what is not covered."""
        del key  # all faces are needed: a face at rest may bound what a moving surface sees
        refuse(self.refusals, Asked(context.packed, context.settings))
        return connect_faces(context.packed)

    def of_paths(self, context: Context, state: Faces, chunk: Chunk, key: PRNGKeyArray) -> Float[Array, "N 3"]:
        """The term of direct light, one value a path."""
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
        kernel = Kernel(self.distance, self.sigma0, self.power, self.boundary_power, self.spread)
        around = Convolution(
            kernel, self.samples, 1, self.debias, False, True, self.normal_edges, rays=context.settings.rays
        )
        warped = Warped(packed, fixed, state, paths, around)
        warp = _warp(warped, measure, *stop_gradient((towards, angle)), lit, key)
        return warp - (along - stop_gradient(along))


def _warp(warped: Warped, measure: Measure, towards, angle, lit, key) -> Float[Array, "N 3"]:
    """div (F v) = F div v + grad F . v at unit directions `towards`, summed over the auxiliary ones."""
    paths = warped.paths
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
    velocities = hidden_velocities(warped.fixed, warped.faces, apex, ends, lit, warped.around, key)

    def f(direction):
        return scale(measure(direction), angle)

    def moved(slot):
        row = velocities.row(slot)
        # No turns here: a turn of the environment is already in F.
        return displacement(warped.packed, paths.position(row), everywhere[row], velocities.seen(slot), turns=False)

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
