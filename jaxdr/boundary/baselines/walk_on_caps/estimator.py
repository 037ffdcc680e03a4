"""Warped areas by walks over spherical caps to the closest silhouettes (Wu et al. 2025); docs/baselines.md."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.baselines.on_directions import direct_light_refusals, warped_directions
from jaxdr.boundary.baselines.walk_on_caps.walks import Views, Walks, upwards, walked_velocities
from jaxdr.boundary.shared.projection import never_silhouettes
from jaxdr.boundary.shared.refusals import Asked, edge_refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.warped_area.divergence import WarpedTerm
from jaxdr.geometry import queries
from jaxdr.whole_numbers import whole


@checked
class WalkOnCaps(WarpedTerm):
    """Direct light by warped areas whose velocities come from walks to the closest silhouettes; for comparison.

    An unbiased estimator after Wu et al. 2025. The velocity of a direction is a mean over a spherical cap around it,
    which reaches to the closest silhouette. Walks of a fixed number of steps estimate it. Nothing is sampled on edges.
    Each step of a walk is one search for the closest silhouette in angle.

    All fields are static.

    - `steps`: caps that a walk goes over, at least 1. With more steps the field is smoother, and
      its estimate noisier.
    - `walks`: walks that start on the rim of the first cap, for the divergence, and as many in it, for the velocity.
    - `share`: radius of a cap over the angle to the closest silhouette, up to 1.
    - `reach`: silhouettes count up to so many radians from a direction. Up to pi, which means all.

    Take `PathTracer(max_depth=2, sampling="emitter")`. With "mis" the derivative is the same but noisier, as with
    `RednerWAS`.

    Raises ValueError for options out of range.
    """

    steps: int = eqx.field(static=True, default=1)
    walks: int = eqx.field(static=True, default=4)
    share: float = eqx.field(static=True, default=1.0)
    reach: float = eqx.field(static=True, default=math.pi)

    refusals = (
        *direct_light_refusals("WalkOnCaps"),
        edge_refusal(
            "WalkOnCaps",
            "interpolated normals",
            "no horizons of surfaces with interpolated normals",
            lambda packed: packed.normals is not None,
        ),
    )

    def __check_init__(self):
        for option in ("steps", "walks"):
            value = getattr(self, option)
            if not whole(value):
                raise ValueError(f"WalkOnCaps: {option} must be a whole number of at least 1, got {value}")
        for option, most in (("share", 1.0), ("reach", math.pi)):
            value = getattr(self, option)
            if not 0 < value <= most:
                raise ValueError(f"WalkOnCaps: {option} must be above 0 and at most {most:.4g}, got {value}")

    def prepare(self, context: Context, key: PRNGKeyArray) -> queries.EdgeSet:
        """The edges with a tree over them. Raises ValueError for what is not covered."""
        del key  # all edges are needed: one at rest may bound what a moving surface sees
        refuse(self.refusals, Asked(context.packed, context.settings))
        packed = jax.tree.map(stop_gradient, context.packed)
        rank = jnp.where(never_silhouettes(packed), 0.0, 1.0).astype(packed.vertices.dtype)
        edges = queries.EdgeSet.of(packed.edges, rank)
        return edges._replace(tree=queries.edge_tree(packed.geometry, edges, packed.edge_counts, context.settings.rays))

    def of_paths(
        self, context: Context, state: queries.EdgeSet, chunk: Chunk, key: PRNGKeyArray
    ) -> Float[Array, "N 3"]:
        """The term of direct light, one value a path."""
        walks = Walks(self.steps, self.walks, self.share, self.reach, context.settings.rays)

        def field(fixed, apex, ends, lit, key):
            views = Views(fixed, state, apex.position, upwards(apex, ends.normal), lit, walks)
            return walked_velocities(views, ends.normal, ends, key)

        return warped_directions(context, chunk, field, key)
