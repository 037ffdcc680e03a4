"""Disney's principled model. Lobes whose parameters are not given are not in the compiled program."""

import math

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import components, dot, from_components, normalize, scale, vanishes, z_of
from jaxdr.scene.bsdf.base import BSDF, both_above
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric, schlick_weight
from jaxdr.scene.bsdf.microfacet import (
    DISTRIBUTIONS,
    Alpha,
    Reflection,
    mirrored_width,
    narrowest,
    reflect,
    reflection,
    refract,
    transmission,
)
from jaxdr.scene.bsdf.parameters import Color, Number, Value, color, number, optional_number
from jaxdr.scene.bsdf.rough_dielectric import reflection_probability, refraction_rims
from jaxdr.scene.color import luminance
from jaxdr.scene.ranges import ranged, within
from jaxdr.scene.sampling import LEAST, choose, cosine_hemisphere, lobe_probability

SHARPEST = 1e-3  # least alpha, as in Mitsuba
# At zero the index has an infinite derivative by `specular`, though the reflectance has not, and facets between equal
# indices don't refract. The root of the base colour, by which light is refracted, has an infinite derivative there too.
LEAST_SPECULAR, LEAST_COLOR = 1e-3, 1e-6
COAT_ALPHAS = 0.1, 0.001  # alpha of a clear coat at gloss 0 and at gloss 1 (Burley 2012)
GRAZING = 1e-6  # least cosine to divide by: below it derivatives of the quotient overflow float32
COAT_SHARE, COAT_FRESNEL, COAT_MASKING = 0.25, 0.04, 0.25

OPTIONAL = (
    *("anisotropic", "spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss"),
    *("spec_trans", "flatness"),
)


@checked
class Principled(BSDF):
    """Disney's principled model and the material of glTF files (Burley 2012 and 2015, as Mitsuba 3's `principled`).

    All parameters are in [0, 1], and all but `base_color` (RGB) are numbers. The part that is not metal has the exact
    Fresnel term. The facets are GGX with alpha = `roughness`^2, at least 0.001. At normal incidence 0.08 x `specular`
    is reflected: the default 0.5 gives glTF's 4 %. `specular` counts as at least 0.001, and the
    base colour of refracted light as at least 0.000001: the root of zero has an infinite derivative.

    The model has the other lobes only if their parameter is given, even as 0:

    - `anisotropic`: facets are rougher along increasing u. The surface needs UVs.
    - `spec_tint`: the reflection of the part that is not metal takes on the base colour.
    - `sheen`: a lobe at grazing angles. It is white, or takes on the base colour by `sheen_tint`.
    - `clearcoat`: a second, narrow reflection. The larger `clearcoat_gloss`, the narrower it is.
    - `spec_trans`: the part that is not metal is rough glass instead of diffuse. Only such a surface has an inside; any
      other is black from behind.
    - `flatness`: the diffuse lobe becomes that of thin skin or wax.

    As in Burley's model, sheen, clear coat and their sum with the diffuse lobe don't conserve energy exactly.
    Raises ValueError for values out of range, `sheen_tint` without `sheen`, and `clearcoat_gloss` without `clearcoat`.
    """

    base_color: Color = eqx.field(metadata=ranged(0.0, 1.0))
    metallic: Number = eqx.field(metadata=ranged(0.0, 1.0))
    roughness: Number = eqx.field(metadata=ranged(0.0, 1.0))
    specular: Number = eqx.field(metadata=ranged(0.0, 1.0))
    anisotropic: Number | None = eqx.field(metadata=ranged(0.0, 1.0))
    spec_tint: Number | None = eqx.field(metadata=ranged(0.0, 1.0))
    sheen: Number | None = eqx.field(metadata=ranged(0.0, 1.0))
    sheen_tint: Number | None = eqx.field(metadata=ranged(0.0, 1.0))
    clearcoat: Number | None = eqx.field(metadata=ranged(0.0, 1.0))
    clearcoat_gloss: Number | None = eqx.field(metadata=ranged(0.0, 1.0))
    spec_trans: Number | None = eqx.field(metadata=ranged(0.0, 1.0))
    flatness: Number | None = eqx.field(metadata=ranged(0.0, 1.0))

    def __init__(
        self,
        base_color: Value = 0.5,
        metallic: Value = 0.0,
        roughness: Value = 0.5,
        specular: Value = 0.5,
        *,
        anisotropic: Value | None = None,
        spec_tint: Value | None = None,
        sheen: Value | None = None,
        sheen_tint: Value | None = None,
        clearcoat: Value | None = None,
        clearcoat_gloss: Value | None = None,
        spec_trans: Value | None = None,
        flatness: Value | None = None,
    ):
        self.base_color = color(base_color, "Principled: base_color")
        self.metallic = number(metallic, "Principled: metallic")
        self.roughness = number(roughness, "Principled: roughness")
        self.specular = number(specular, "Principled: specular")
        self.anisotropic = optional_number(anisotropic, "Principled: anisotropic")
        self.spec_tint = optional_number(spec_tint, "Principled: spec_tint")
        self.sheen = optional_number(sheen, "Principled: sheen")
        self.sheen_tint = optional_number(sheen_tint, "Principled: sheen_tint")
        self.clearcoat = optional_number(clearcoat, "Principled: clearcoat")
        self.clearcoat_gloss = optional_number(clearcoat_gloss, "Principled: clearcoat_gloss")
        self.spec_trans = optional_number(spec_trans, "Principled: spec_trans")
        self.flatness = optional_number(flatness, "Principled: flatness")
        for detail, lobe in (("sheen_tint", "sheen"), ("clearcoat_gloss", "clearcoat")):
            if getattr(self, detail) is not None and getattr(self, lobe) is None:
                raise ValueError(f"Principled: {detail} has no effect without {lobe}")

    @property
    def transmissive(self) -> bool:
        return self.spec_trans is not None

    @property
    def tangential(self) -> bool:
        return self.anisotropic is not None

    def eval(self, wi, wo):
        front = z_of(wi) > 0
        wi, wo, eta = self._seen_from_above(wi, wo)
        above, alpha = both_above(wi, wo), self._alpha()
        facets = reflection("ggx", alpha, wi, wo, above)
        dielectric = fresnel_dielectric(facets.cosine, eta).reflectance
        fresnel = self._fresnel(facets, dielectric, eta)
        if self.spec_trans is not None:
            above &= front
            glass = (1.0 - self.metallic) * self.spec_trans
            inside = glass * dielectric
            fresnel = jnp.where(front[..., None], fresnel, from_components(inside, inside, inside))
        value = scale(fresnel, facets.value) + scale(self.base_color, self._diffuse(facets, wi, wo, above))
        if self.spec_trans is not None:
            through = transmission("ggx", alpha, wi, wo, eta).value
            value = value + scale(jnp.sqrt(_raised(self.base_color, LEAST_COLOR)), glass * through)
        if self.sheen is not None:
            share = self.sheen * (1.0 - self.metallic) * schlick_weight(facets.cosine) * z_of(wo)
            value = value + scale(self._sheen_color(), jnp.where(above, share, 0.0))
        if self.clearcoat is not None:
            coat = COAT_SHARE * self.clearcoat * self._coat(wi, wo, above).value
            value = value + from_components(coat, coat, coat)
        return value

    def pdf(self, wi, wo):
        front = z_of(wi) > 0
        wi, wo, eta = self._seen_from_above(wi, wo)
        above, chance, alpha = both_above(wi, wo), self._facet_probability(), self._alpha()
        facets = reflection("ggx", alpha, wi, wo, above).pdf
        rest = 1.0 - chance
        if self.spec_trans is not None:
            above &= front
            chance, rest = jnp.where(front, chance, 1.0), jnp.where(front, rest, 0.0)
            reflects = self._reflection_probability(wi, eta, front)
            facets = reflects * facets + (1.0 - reflects) * transmission("ggx", alpha, wi, wo, eta).pdf
        diffuse = jnp.where(above, z_of(wo), 0.0) / math.pi
        if self.clearcoat is not None:
            coats = self._coat_probability()
            diffuse = (1.0 - coats) * diffuse + coats * self._coat(wi, wo, above).pdf
        return chance * facets + rest * diffuse

    def sample(self, wi, u):
        front = z_of(wi) > 0
        side = jnp.where(z_of(wi) < 0, -1.0, 1.0).astype(wi.dtype)
        wi, _, eta = self._seen_from_above(wi, wi)
        chance = jnp.broadcast_to(self._facet_probability(), wi.shape[:-1])
        if self.spec_trans is not None:
            chance = jnp.where(front, chance, 1.0)
        facets, left = choose(u, chance)
        diffuse = left
        if self.spec_trans is not None:
            reflects, left = choose(left, self._reflection_probability(wi, eta, front))
        m = DISTRIBUTIONS["ggx"].sample(wi, self._alpha(), left)
        mirrored = reflect(wi, m)
        if self.spec_trans is not None:
            refracted, passes = refract(wi, m, eta)
            valid = jnp.where(reflects, z_of(mirrored) > 0, passes & (z_of(refracted) < 0))
            mirrored = jnp.where((reflects & valid)[..., None], mirrored, jnp.where(valid[..., None], refracted, 0.0))
        if self.clearcoat is None:
            other = cosine_hemisphere(diffuse)
        else:
            coats, diffuse = choose(diffuse, jnp.broadcast_to(self._coat_probability(), wi.shape[:-1]))
            coat = reflect(wi, _sample_coat(self._coat_alpha(), diffuse))
            coat = jnp.where((z_of(coat) > 0)[..., None], coat, 0.0)
            other = jnp.where(coats[..., None], coat, cosine_hemisphere(diffuse))
        wo = jnp.where(facets[..., None], mirrored, other)
        return wo if self.spec_trans is None else scale(wo, side)

    def lobe_width(self, wi):
        """The width of the narrowest lobe, whatever share of the light it scatters."""
        width = mirrored_width(self._alpha())
        if self.clearcoat is not None:
            width = jnp.minimum(width, mirrored_width(self._coat_alpha()))
        if self.spec_trans is not None:
            relative = jnp.where(z_of(wi) > 0, 1.0 / self._eta(), self._eta())
            width = jnp.minimum(width, narrowest(self._alpha()) * jnp.abs(1.0 - relative))
        return jnp.broadcast_to(width, wi.shape[:-1])

    def rims(self, wi):
        return super().rims(wi) if self.spec_trans is None else refraction_rims(wi, self._eta())

    def _seen_from_above(self, wi, wo):
        """(wi, wo, index beyond the surface over that on wi's side); mirrored if wi is below and there is an inside."""
        eta = self._eta()
        if self.spec_trans is None:
            return wi, wo, eta
        below = z_of(wi) < 0
        side = jnp.where(below, -1.0, 1.0).astype(wi.dtype)
        return scale(wi, side), scale(wo, side), jnp.where(below, 1.0 / eta, eta)

    def _fresnel(self, facets: Reflection, dielectric, eta) -> Float[Array, "*n 3"]:
        """Fresnel term of the front: Schlick's for metal and for the tinted share, exact for the rest."""
        schlick = schlick_weight(facets.cosine)
        metal = self.base_color + scale(1.0 - self.base_color, schlick)
        grey = (1.0 - self.metallic) * dielectric
        if self.spec_tint is None:
            return scale(metal, self.metallic) + from_components(grey, grey, grey)
        grey = grey * (1.0 - self.spec_tint)
        head_on = scale(self._tint(), jnp.square((eta - 1.0) / (eta + 1.0)))
        tinted = scale(head_on + scale(1.0 - head_on, schlick), (1.0 - self.metallic) * self.spec_tint)
        return scale(metal, self.metallic) + from_components(grey, grey, grey) + tinted

    def _diffuse(self, facets: Reflection, wi, wo, above) -> Float[Array, "*n"]:
        """The diffuse lobe with retro-reflection: a factor 1 + `extreme` at grazing angles (Burley 2012, 5.3)."""
        retro = 2.0 * self.roughness * facets.cosine * facets.cosine
        extreme = retro - 0.5
        at_wi, at_wo = schlick_weight(z_of(wi)), schlick_weight(z_of(wo))
        diffuse = (1.0 + extreme * at_wi) * (1.0 + extreme * at_wo)
        if self.flatness is not None:
            # Burley 2015, 4.3, after Hanrahan and Krueger 1993.
            flat = (1.0 + (0.5 * retro - 1.0) * at_wi) * (1.0 + (0.5 * retro - 1.0) * at_wo)
            cosines = jnp.maximum(jnp.where(above, z_of(wi) + z_of(wo), 1.0), GRAZING)
            flat = 1.25 * (flat * (1.0 / cosines - 0.5) + 0.5)
            diffuse = diffuse + self.flatness * (flat - diffuse)
        share = 1.0 - self.metallic
        if self.spec_trans is not None:
            share = share * (1.0 - self.spec_trans)
        return jnp.where(above, share * diffuse * z_of(wo) / math.pi, 0.0)

    def _tint(self) -> Float[Array, "*n 3"]:
        """The base colour scaled to luminance 1; white for black."""
        brightness = luminance(self.base_color)
        lit = brightness > 0
        tint = scale(self.base_color, 1.0 / jnp.where(lit, brightness, 1.0))
        return jnp.where(lit[..., None], tint, 1.0)

    def _sheen_color(self) -> Float[Array, "*n 3"]:
        if self.sheen_tint is None:
            return jnp.ones_like(self.base_color)
        return 1.0 + scale(self._tint() - 1.0, self.sheen_tint)

    def _coat(self, wi, wo, above) -> Reflection:
        """The clear coat without its weight: GTR1 facets, sampled by all normals, not by visible ones (Burley 2012)."""
        above = above & ~vanishes(wi + wo)
        up = jnp.asarray([0.0, 0.0, 1.0], wi.dtype)
        wi, wo = jnp.where(above[..., None], wi, up), jnp.where(above[..., None], wo, up)
        half = normalize(wi + wo)
        cosine = dot(wi, half)
        density = _coat_density(self._coat_alpha(), half)
        fresnel = COAT_FRESNEL + (1.0 - COAT_FRESNEL) * schlick_weight(cosine)
        masking, rough = DISTRIBUTIONS["ggx"].masking, jnp.asarray(COAT_MASKING, wi.dtype)
        shadows = masking(wi, rough) * z_of(wi) * masking(wo, rough) * z_of(wo)
        value, seen = fresnel * density * shadows * z_of(wo), above & (cosine > GRAZING)
        pdf = density * z_of(half) / (4.0 * jnp.where(seen, cosine, 1.0))
        return Reflection(jnp.where(above, value, 0.0), jnp.where(seen, pdf, 0.0), cosine)

    def _alpha(self) -> Alpha:
        alpha = self.roughness * self.roughness
        if self.anisotropic is None:
            return jnp.maximum(alpha, SHARPEST)
        aspect = jnp.sqrt(1.0 - 0.9 * within(self.anisotropic, 0.0, 1.0))
        return jnp.maximum(alpha / aspect, SHARPEST), jnp.maximum(alpha * aspect, SHARPEST)

    def _coat_alpha(self) -> Float[Array, "*n"]:
        dull, glossy = COAT_ALPHAS
        assert self.clearcoat is not None
        gloss = jnp.zeros_like(self.clearcoat) if self.clearcoat_gloss is None else self.clearcoat_gloss
        return dull + (glossy - dull) * within(gloss, 0.0, 1.0)

    def _eta(self) -> Float[Array, "*n"]:
        return 2.0 / (1.0 - jnp.sqrt(0.08 * _raised(within(self.specular, 0.0, 1.0), LEAST_SPECULAR))) - 1.0

    def _facet_probability(self) -> Float[Array, "*n"]:
        """Probability of facets on the front. They have weight 1; the diffuse lobe and the coat have their weights."""
        return lobe_probability(1.0, jnp.abs(self._diffuse_weight()) + jnp.abs(self._coat_weight()))

    def _coat_probability(self) -> Float[Array, "*n"]:
        """Probability of the coat where facets are not chosen."""
        return lobe_probability(self._coat_weight(), self._diffuse_weight())

    def _diffuse_weight(self):
        return (1.0 - self.metallic) * (1.0 if self.spec_trans is None else 1.0 - self.spec_trans)

    def _coat_weight(self):
        return 0.0 if self.clearcoat is None else COAT_SHARE * self.clearcoat

    def _reflection_probability(self, wi, eta, front) -> Float[Array, "*n"]:
        """Probability that facets reflect rather than refract. On the inside there is only glass."""
        assert self.spec_trans is not None
        through = 1.0 - reflection_probability(self._alpha(), wi, eta)
        glass = jnp.clip(jnp.abs((1.0 - self.metallic) * self.spec_trans), LEAST, 1.0)
        return 1.0 - through * jnp.where(front, glass, 1.0)


def _optional(value, name: str) -> Number | None:
    return None if value is None else number(value, f"Principled: {name}", 0.0, 1.0)


def _raised(value: Float[Array, "*n"], least: float) -> Float[Array, "*n"]:
    """The value, but at least `least`. Smaller values have the derivative of the least one, not zero."""
    return value + stop_gradient(jnp.maximum(least - value, 0.0))


def _coat_density(alpha: Float[Array, "*#n"], m: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """GTR1 (Burley 2012, Eq. 4), in 1/sr; written with x and y for the reason given in `microfacet._ggx_density`."""
    x, y, z = components(m)
    alpha2 = alpha * alpha
    return (alpha2 - 1.0) / (math.pi * jnp.log(alpha2) * (x * x + y * y + alpha2 * z * z))


def _sample_coat(alpha: Float[Array, "*#n"], u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Normals with density D cos, in 1/sr (Burley 2012, Eq. 5)."""
    first, second = components(u)
    alpha2 = alpha * alpha
    sin2 = (jnp.power(alpha2, 1.0 - first) - alpha2) / (1.0 - alpha2)
    radius, angle = jnp.sqrt(jnp.maximum(sin2, 0.0)), 2.0 * math.pi * second
    z = jnp.sqrt(jnp.maximum(1.0 - sin2, 0.0))
    return from_components(radius * jnp.cos(angle), radius * jnp.sin(angle), z)
