"""Transfer of light between two vertices of a path: BSDF, geometric term, visibility."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, normalize, scale
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, leave
from jaxdr.transport.shading import Scatterer


class Vertex(NamedTuple):
    """A vertex of N paths: the point, the unit direction `wi` back along the path, and the throughput (RGB)."""

    point: SurfacePoint
    wi: Float[Array, "N 3"]
    throughput: Float[Array, "N 3"]


class Transfer(NamedTuple):
    """From a vertex towards a target: `value` = f_s |cos| G J (RGB).

    G is |cosine at the target| over the squared distance, 1 at infinity. `towards` is a unit direction, `cosine` the
    signed cosine at the target, `geometry` = G J. All are differentiable.
    """

    value: Float[Array, "N 3"]
    towards: Float[Array, "N 3"]
    distance2: Float[Array, " N"]
    cosine: Float[Array, " N"]
    geometry: Float[Array, " N"]

    def scatters(self, scatterer: Scatterer, black: bool) -> Bool[Array, " N"]:
        """Whether light may pass; with `black` also where only the derivative by a parameter of the BSDF is not zero.

        The derivative by what moves is zero where the value is: a BSDF is never negative. So `black` is needed only if
        parameters of BSDFs are differentiated.
        """
        return scatterer.may_scatter(self.towards) if black else (stop_gradient(self.value) != 0).any(-1)


def transfer_to(
    scatterer: Scatterer,
    target: SurfacePoint,
    infinite: Bool[Array, " N"],
    direction: Float[Array, "N 3"],
    delta: Bool[Array, " N"] | None = None,
) -> Transfer:
    """Transfer towards points, or in `direction` where `infinite`. `delta` points have no area: their cosine is 1."""
    offset = target.position - scatterer.point.position
    towards = jnp.where(infinite[:, None], direction, normalize(offset))
    distance2 = jnp.where(infinite, 1.0, jnp.maximum(dot(offset, offset), 1e-30))
    cosine = jnp.where(infinite, 1.0, -dot(target.normal, towards))
    if delta is not None:
        cosine = jnp.where(delta, 1.0, cosine)
    geometry = jnp.where(infinite, 1.0, jnp.abs(cosine) / distance2 * target.area_ratio())
    return Transfer(scale(scatterer.eval(towards), geometry), towards, distance2, cosine, geometry)


def unoccluded(
    packed: PackedScene,
    scatterer: Scatterer,
    target: SurfacePoint,
    infinite: Bool[Array, " N"],
    towards: Float[Array, "N 3"],
    asked: Bool[Array, " N"],
    rays: str,
) -> Bool[Array, " N"]:
    """Whether nothing is between vertices and targets in the directions `towards`; False where not `asked`."""
    start = scatterer.leave(towards)
    end = leave(target, -towards)
    end = jnp.where(infinite[:, None], start + 2.0 * packed.size * stop_gradient(towards), end)
    reach = jnp.where(asked, 1.0, 0.0).astype(start.dtype)
    return asked & ~queries.occluded(packed.geometry, queries.Rays(start, end - start, reach), rays)
