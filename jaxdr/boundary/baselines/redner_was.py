"""Warped areas on the sphere of directions (Bangaru et al. 2020; "Redner_WAS" in Xu et al. 2023), direct light only.

The velocity of a direction is a convolution of those of the material points that are seen around it.
"""

from typing import Literal

import equinox as eqx
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.baselines.on_directions import direct_light_refusals, warped_directions
from jaxdr.boundary.shared.face_neighbours import Faces, connect_faces
from jaxdr.boundary.shared.refusals import Asked, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.shared.traits import Traits
from jaxdr.boundary.warped_area.continuous_velocity import Convolution, Kernel
from jaxdr.boundary.warped_area.divergence import WarpedTerm, check_options, hidden_velocities, reaches_no_boundary


@checked
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

    refusals = direct_light_refusals("RednerWAS")

    def __check_init__(self):
        check_options(self, ("samples",))

    def known_failure(self, found: Traits) -> str:
        """See `jaxdr.boundary.shared.traits`."""
        del found  # on every scene
        if self.distance == "path_space" and not self.normal_edges:
            return (
                "with normal_edges=False the motion of silhouettes between two faces is missing; take "
                "normal_edges=True, or LineSampling"
            )
        return reaches_no_boundary(self) or (
            "up to half of a derivative is missing under small lights and behind narrow blockers (docs/stability.md); "
            "take LineSampling"
        )

    def prepare(self, context: Context, key: PRNGKeyArray) -> Faces:
        """Normals and neighbours of all faces, once for a whole image. Raises ValueError for what is not covered."""
        del key  # all faces are needed: a face at rest may bound what a moving surface sees
        refuse(self.refusals, Asked(context.packed, context.settings))
        return connect_faces(context.packed)

    def of_paths(self, context: Context, state: Faces, chunk: Chunk, key: PRNGKeyArray) -> Float[Array, "N 3"]:
        """The term of direct light, one value a path."""
        kernel = Kernel(self.distance, self.sigma0, self.power, self.boundary_power, self.spread)
        around = Convolution(
            kernel, self.samples, 1, self.debias, False, True, self.normal_edges, rays=context.settings.rays
        )

        def field(fixed, apex, ends, lit, key):
            return hidden_velocities(fixed, state, apex, ends, lit, around, key)

        return warped_directions(context, chunk, field, key)
