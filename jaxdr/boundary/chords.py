"""Random chords through the far ends of path segments, and what a boundary point on one weighs (DESIGN 2b).

A centre c is drawn with density p(c) and a direction phi uniform in [0, pi). Every piece dl of a boundary curve is
crossed by the centres of a strip of area |sin(phi - phi_l)| dl dt (Cauchy-Crofton), so for any kernel k whose integral
over the chord through the boundary point mu is one,

    integral of f V dl  =  E_{c, phi} [ sum over crossings mu of  f(mu) V(mu) (pi / 2) k(c) / p(c) ].
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int

from jaxdr.boundary.emitter_planes import chord_inside
from jaxdr.geometry.queries import UNBOUNDED, UNBOUNDED_FOLDS
from jaxdr.geometry.vector import dot, normalize, orthonormal_basis
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.shading import EmitterSample, Scatterer, sample_emitter


class Chords(NamedTuple):
    """M chords, detached: from `first` to `last`, its centre at the share `centre` of the way.

    `group` as in `queries.sector_crossings`. `weight` = (pi / 2) k / p, RGB, times the emitter's radiance for chords on
    emitters; zero where a chord is of no use.
    """

    first: Float[Array, "M 3"]
    last: Float[Array, "M 3"]
    centre: Float[Array, " M"]
    group: Int[Array, " M"]
    weight: Float[Array, "M 3"]


def emitter_chords(
    packed: PackedScene, group: Int[Array, " F"], apex: Float[Array, "M 3"], u: Float[Array, "M 3"]
) -> tuple[Chords, EmitterSample]:
    """Whole chords of emitters, in area measure: k = 1 / length, so that nothing depends on where the centre is."""
    sample = sample_emitter(packed, u[:, :2])
    point, normal = stop_gradient(sample.point.position), stop_gradient(sample.point.normal)
    s, t = orthonormal_basis(normal)
    angle = math.pi * u[:, 2]
    direction = jnp.cos(angle)[:, None] * s + jnp.sin(angle)[:, None] * t
    first, last, length = chord_inside(packed, group, sample.point.face, point, direction)
    useful = (length > 0) & ~sample.infinite & (dot(apex - point, normal) > 0)
    density = jnp.where(useful, sample.pdf * length, 1.0)
    weight = stop_gradient(sample.radiance) * jnp.where(useful, 0.5 * math.pi / density, 0.0)[:, None]
    whole = jnp.where(useful, last - first, 1.0)
    chords = Chords(
        first=point + first[:, None] * direction,
        last=point + last[:, None] * direction,
        centre=-first / whole,
        group=group[sample.point.face],
        weight=weight,
    )
    return chords, sample


class LobeChords(NamedTuple):
    """Geodesic chords around directions from the BSDF: `centre` directions with density `pdf` (solid angle).

    Half-length `reach` (radians), in planes with the unit normals `plane`.
    """

    centre: Float[Array, "M 3"]
    pdf: Float[Array, " M"]
    plane: Float[Array, "M 3"]
    reach: Float[Array, " M"]

    def chords(self, apex: Float[Array, "M 3"], far: Float[Array, ""], folds: bool = False) -> Chords:
        """Sectors without an end, for the search; `far` is a distance beyond the scene. They have no weight yet.

        With `folds`, edges between faces are looked for as well as silhouettes.
        """
        across = jnp.cross(self.plane, self.centre)
        cosine, sine = jnp.cos(self.reach)[:, None], jnp.sin(self.reach)[:, None]
        return Chords(
            first=apex + far * (cosine * self.centre - sine * across),
            last=apex + far * (cosine * self.centre + sine * across),
            centre=jnp.full_like(self.pdf, 0.5),
            group=jnp.full(self.pdf.shape, UNBOUNDED_FOLDS if folds else UNBOUNDED),
            weight=jnp.broadcast_to(jnp.where(self.pdf > 0, 1.0, 0.0)[:, None], self.centre.shape),
        )


def lobe_chords(scatterer: Scatterer, width: Float[Array, " M"], u: Float[Array, "M 3"]) -> LobeChords:
    """Chords in solid angle, of half-length `width` (radians), around BSDF-sampled directions."""
    centre = scatterer.sample(u[:, :2])
    s, t = orthonormal_basis(centre)
    angle = math.pi * u[:, 2]
    plane = jnp.cos(angle)[:, None] * s + jnp.sin(angle)[:, None] * t
    return LobeChords(centre, scatterer.pdf(centre), plane, width)


def lobe_weight(
    scatterer: Scatterer, chords: LobeChords, boundary: Float[Array, "M 3"], uniform: bool = False
) -> Float[Array, " M"]:
    """(pi / 2) k / p for boundary points in unit directions `boundary`, crossed by the chords.

    k is proportional to the cosine at the sampled direction: that takes the 1 / cosine out of f / p near the horizon,
    below which nothing is sampled. Or `uniform` for narrow lobes, whose f / p has no such factor. Its integral is over
    the arc of centres whose chords reach the boundary point.
    """
    height = scatterer.cosine(chords.centre)
    side = jnp.sign(height)
    along = normalize(jnp.cross(chords.plane, boundary))
    a, b = side * scatterer.cosine(boundary), side * scatterer.cosine(along)
    horizon = jnp.arctan2(b, a)  # a cos t + b sin t > 0 within 90 degrees of it
    low, high = jnp.maximum(-chords.reach, horizon - 0.5 * jnp.pi), jnp.minimum(chords.reach, horizon + 0.5 * jnp.pi)
    if uniform:
        kernel, mass = jnp.ones_like(height), high - low
    else:
        kernel, mass = jnp.abs(height), a * (jnp.sin(high) - jnp.sin(low)) - b * (jnp.cos(high) - jnp.cos(low))
    counts = (a > 0) & (high > low) & (mass > 0) & (chords.pdf > 0)
    return jnp.where(counts, 0.5 * math.pi * kernel / jnp.where(counts, mass * chords.pdf, 1.0), 0.0)
