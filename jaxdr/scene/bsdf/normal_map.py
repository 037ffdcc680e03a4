"""Normal map, and what it shares with the bump map: shading normals that differ at every point."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import (
    Frame,
    components,
    cross,
    dot,
    from_components,
    normalize,
    orthonormal_basis,
    scale,
    vanishes,
    z_of,
)
from jaxdr.scene.bsdf.base import BSDF, Adapter, DeltaSample, TwoSided, no_delta
from jaxdr.scene.bsdf.parameters import Color, Value, color
from jaxdr.scene.ranges import ranged


class TurnedNormal(Adapter):
    """Adapter: a BSDF whose normal is turned at every point.

    A normal that faces away from the viewer is rotated by half a turn around z. Light is shadowed at grazing angles as
    by a rough surface (Estevez et al. 2019).
    """

    bsdf: eqx.AbstractVar[BSDF]

    @abc.abstractmethod
    def turned_normal(self) -> Float[Array, "*#n 3"]:
        """The normal, of any length, in the frame of the surface."""

    @property
    def tangential(self) -> bool:
        return True

    def eval(self, wi, wo):
        frame = self._frame(wi)
        value = scale(self.bsdf.eval(frame.to_local(wi), frame.to_local(wo)), frame.shadowing(wo))
        return jnp.where(frame.keeps_side(wo)[..., None], value, 0.0)

    def pdf(self, wi, wo):
        frame = self._frame(wi)
        return jnp.where(frame.keeps_side(wo), self.bsdf.pdf(frame.to_local(wi), frame.to_local(wo)), 0.0)

    def sample(self, wi, u):
        frame = self._frame(wi)
        wo = frame.to_surface(self.bsdf.sample(frame.to_local(wi), u))
        return jnp.where(frame.keeps_side(wo)[..., None], wo, 0.0)

    def sample_delta(self, wi, u):
        if not self.delta:
            return no_delta(wi)
        frame = self._frame(wi)
        inside = self.bsdf.sample_delta(frame.to_local(wi), u)
        wo = frame.to_surface(inside.wo)
        keeps = frame.keeps_side(wo)
        weight = jnp.where(keeps[..., None], scale(inside.weight, frame.shadowing(wo)), 0.0)
        return DeltaSample(wo, weight, inside.probability)

    def adjoint_delta(self, wi, u):
        frame = self._frame(wi)
        inside = self.bsdf.adjoint_delta(frame.to_local(wi), u)
        wo = frame.to_surface(inside.wo)
        # The light goes from wi to wo, so the viewer is at wo, and wi is the direction that is shadowed.
        weight = scale(inside.weight, frame.shadowing(wi))
        return DeltaSample(wo, jnp.where(self.delta_reverses(wi, wo)[..., None], weight, 0.0), inside.probability)

    def delta_reverses(self, wi, wo):
        one, two = self._frame(wi), self._frame(wo)
        return one.turned == two.turned

    def lobe_width(self, wi):
        return self.bsdf.lobe_width(self._frame(wi).to_local(wi))

    def _frame(self, w) -> "_Frame":
        return _Frame(self.turned_normal(), w, self.bsdf.tangential)


@checked
class NormalMap(TurnedNormal):
    """A BSDF whose normal is turned at every point, by a texture of normals (Mitsuba 3's `normalmap`).

    `normal` is RGB in [0, 1] and stores (n + 1) / 2; read it by `Bitmap.from_file` with `raw`. n is in the frame of the
    surface: x along increasing u, z along the shading normal, y at right angles to both. A normal that faces away from
    the viewer is rotated by half a turn around z. Light is shadowed at grazing angles as by a rough surface (Estevez et
    al. 2019). For a two-sided BSDF write `TwoSided(NormalMap(normal, bsdf))`.

    Where a mapped normal begins to face away, at grazing angles, the image jumps inside faces. The motion of that jump
    has no derivative, and `render` warns of it (docs/limits.md).

    Raises ValueError for a two-sided BSDF inside.
    """

    normal: Color = eqx.field(metadata=ranged(0.0, 1.0))
    bsdf: BSDF

    def __init__(self, normal: Value, bsdf: BSDF | TwoSided):
        self.normal = color(normal, "NormalMap: normal")
        self.bsdf = one_sided(bsdf, "NormalMap", "normal")

    def turned_normal(self):
        return 2.0 * self.normal - 1.0


def one_sided(bsdf: BSDF | TwoSided, adapter: str, first: str) -> BSDF:
    """The BSDF for an adapter. Raises ValueError for a two-sided one, and says where `TwoSided` belongs."""
    if not isinstance(bsdf, BSDF):
        inside = type(bsdf).__name__
        raise ValueError(f"{adapter}: bsdf can't be a {inside}; a two-sided one is TwoSided({adapter}({first}, bsdf))")
    return bsdf


class _Frame:
    """A frame whose z axis is the turned normal. With `along_u` its x axis is close to that of the surface."""

    def __init__(self, n: Float[Array, "*#n 3"], wi: Float[Array, "*#n 3"], along_u: bool):
        self.turned = z_of(wi) * dot(wi, n) <= 0
        n = jnp.where(self.turned[..., None], n * jnp.asarray([-1.0, -1.0, 1.0], n.dtype), n)
        none = dot(n, n) == 0
        self.normal = normalize(jnp.where(none[..., None], jnp.asarray([0.0, 0.0, 1.0], n.dtype), n))
        s, t = _tangents(self.normal) if along_u else orthonormal_basis(self.normal)
        self.axes = Frame(s, t, self.normal)

    def to_local(self, w: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Directions from the frame of the surface to this one."""
        return self.axes.to_local(w)

    def to_surface(self, v: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Directions from this frame to that of the surface."""
        return self.axes.to_world(v)

    def keeps_side(self, w: Float[Array, "*n 3"]):
        """Whether directions are on the same side by the surface's normal and by the turned normal."""
        return z_of(w) * dot(w, self.normal) > 0

    def shadowing(self, w: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """GGX masking whose roughness grows with the angle of the turned normal (Estevez et al. 2019, Eq. 2 and 3)."""
        alpha2 = jnp.minimum(0.125 * _tangent2(self.normal), 1.0)
        return 2.0 / (1.0 + jnp.sqrt(1.0 + alpha2 * _tangent2(w)))


def _tangents(normal):
    """Two tangents to unit normals. The first is the x axis without its part along the normal; the second follows."""
    x, y, z = components(normal)
    along = from_components(1.0 - x * x, -x * y, -x * z)
    unknown = vanishes(along)  # where the normal is the x axis
    s = normalize(jnp.where(unknown[..., None], jnp.asarray([0.0, 0.0, -1.0], normal.dtype), along))
    return s, cross(normal, s)


def _tangent2(w):
    """Squared tangent of the angle to z; large, but finite, at a right angle."""
    cosine2 = jnp.maximum(jnp.square(z_of(w)), 1e-12)
    return jnp.maximum(1.0 - cosine2, 0.0) / cosine2
