"""Warped areas on the sphere of directions (Bangaru et al. 2020; "Redner_WAS" in Xu et al. 2023), direct light only.

The integrand of direct light as a function of the direction w at a shading point y, F(w) = L(y, w) f_s(w) cos (Eq. 55),
jumps wherever the light that is seen ends: at occluders' silhouettes and at all outlines of the emitter itself, which
the material form has fixed on the surface (Eq. 56). With a continuous field v on the sphere that is the velocity of
these curves where they are approached,

    dI/d theta = int [dF/d theta at a fixed direction + div (F v)] d sigma.

`render`'s interior term is in material form: its directions move with the emitter's points, with a velocity m, so that
it is int [dF/d theta + div (F m)] d sigma, point by point. What is added here is div (F v) - div (F m): a warp by
v - m. So the sum is the spherical estimator, at the path tracer's own emitter samples.
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

    Each direction has a velocity: that of the material point seen in it, on the emitter or on whatever hides it. It is
    zero where nothing is seen. The boundary-test function B is that point's (Eq. 18). Every auxiliary direction costs
    one ray. Prefer `WarpedArea`: there the outlines of emitters do not move, and need no warp.

    All fields are static.

    - `distance`: "exponential" (Eq. 57), that of the original, or "path_space" (Eq. 16).
    - `normal_edges`: whether B vanishes at silhouettes that are edges between two faces, where the normal jumps. All
      outlines of a cube are such edges. Without them only cosines and open edges count, as the authors of Xu et al.
      found it in the public implementation (Fig. 18). Then the velocity field does not reach the velocity of such an
      outline, and the derivative is wrong. An edge that is no outline of what is seen needs no warp.
    - `sigma0`, `power`, `samples`, `boundary_power`, `debias`, `spread`: as of `WarpedArea`, in radians on the sphere.

    Take `PathTracer(max_depth=2, sampling="emitter")`. With "mis" the derivative is the same, but noisier: a part of
    the interior term is at other samples and does not cancel.

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
        del key  # every face may bound what moving surfaces see, whatever moves
        refuse(self.refusals, Asked(context.packed, context.settings))
        return connect_faces(context.packed)

    def of_paths(self, context: Context, state: Faces, chunk: Chunk, key: PRNGKeyArray) -> Float[Array, "N 3"]:
        """Direct light."""
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

        # Along with the emitter's points, div (F m): leave it out of the interior term.
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
        # Directions are frames of their own: what turns the environment is in F.
        return displacement(warped.packed, paths.position(row), everywhere[row], velocities.seen(slot), turns=False)

    # On the unit sphere a direction is where the target is, less the apex.
    around_apex = dataclasses.replace(ends, target=towards)
    return divergence_term(f, f(towards), around_apex, lit, velocities, moved)


def _measure(packed: PackedScene, paths: PathSegments, index: Int[Array, " N"]) -> Measure:
    """Of emitter samples: F / pdf (per area) as a function of the unit direction at the apex, detached but for that."""
    scatterer, table = paths.scatterer(index), paths.table

    def measure(towards):
        weight = table.weight[index]
        if table.unlit is not None and packed.has_varying_sky:
            sky = environment_radiance(packed, towards)
            weight = jnp.where(table.infinite[index][:, None], table.unlit[index] * sky, weight)
        return weight * scatterer.eval(normalize(towards))

    return measure
