"""How far renderings are from photographs, the unbiased gradient of that, and priors."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.geometry.mesh import Mesh
from jaxdr.integrators import Integrator
from jaxdr.optimize.devices import ALONE, Division
from jaxdr.optimize.losses import without
from jaxdr.optimize.reconstruction.cameras import corrected
from jaxdr.optimize.reconstruction.config import Priors, Samples
from jaxdr.optimize.reconstruction.unknowns import Unknowns, reflectance, scene_of
from jaxdr.scene.color import luminance
from jaxdr.scene.film import Box, Film
from jaxdr.views.rendering import Layers, Pinhole, layers

DARK = 0.02  # linear; darker pixels weigh no more than those: an 8-bit photograph has few steps there
OUTLIER = 0.3  # sRGB; beyond it a difference counts by its size and not by its square
WHITE = 0.995  # photographs are clipped from here on
LAMP = 0.3  # logarithm of radiance; larger differences of neighbouring directions are outlines of lamps
TINT = 0.5  # of the mean light; colours well beyond it are those of lamps
JUMP = 0.05  # albedo; differences of neighbours well beyond it are edges of paint, and count by their size


class Photograph(NamedTuple):
    """What one view is compared with: colours (over black where there is alpha), alpha or None, weight of the colours,
    its number, and where it has pixels at all."""

    color: Float[Array, "H W 3"]
    alpha: Float[Array, "H W"] | None
    trust: Float[Array, "H W"]
    number: Int[Array, ""]
    framed: Float[Array, "H W"]


def huber(x: Float[Array, "*n"], width: float) -> Float[Array, "*n"]:
    """x² within `width`, beyond that 2 width |x| - width²."""
    size = jnp.abs(x)
    return jnp.where(size <= width, x * x, width * (2 * size - width))


def tone_weight(color: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Slope of the sRGB curve at linear values: differences times it are those of encoded values, to first order.

    It depends on the photograph alone. So the loss is quadratic in the rendering, and noise adds a constant to its
    expectation; encoding the noisy rendering itself would make dark pixels look too dark.
    """
    return 1.055 / 2.4 * jnp.maximum(color, DARK) ** (1 / 2.4 - 1)


def picture_loss(
    parts: Layers, exposure: Float[Array, "3"], photograph: Photograph, mask_weight: float
) -> Float[Array, ""]:
    """Tone-weighted, robust squared difference of colours, plus `mask_weight` times that of coverage; means of pixels.

    Where the photograph is clipped a rendering may be brighter.
    """
    shown = parts.full if photograph.alpha is None else parts.over_black
    shown, color = without(photograph.trust == 0, shown, photograph.color)
    error = jnp.exp(exposure) * shown - color
    clipped = color >= WHITE
    error = jnp.where(clipped, jnp.minimum(error, 0.0), error) * tone_weight(color)
    loss = (huber(error, OUTLIER) * photograph.trust[..., None]).mean()
    if photograph.alpha is None:
        return loss
    return loss + mask_weight * (photograph.framed * (parts.alpha - photograph.alpha) ** 2).mean()


def view_gradient(
    integrator: Integrator, samples: Samples, mask_weight: float, division: Division = ALONE, cameras: bool = False
) -> Callable:
    """Function (mesh, unknowns, camera, photograph, key) -> (loss, its gradient by the unknowns, picture [H, W, 4]).

    The loss is that of one picture. Its derivative by the picture multiplies the derivative of another, independent
    picture: their product is an unbiased gradient of the expected loss, which is that of the noiseless picture and a
    constant wherever the loss is quadratic. Devices that share a view take part of the samples of each picture. With
    `cameras` the poses are corrected, and the gradient by their corrections is computed.
    """

    def gradient(mesh: Mesh, unknowns: Unknowns, pinhole: Pinhole, photograph: Photograph, key: PRNGKeyArray):
        height, width, _ = photograph.color.shape
        film = Film(width, height, Box())
        image_key, derivative_key = (division.own_key(k) for k in jax.random.split(key))

        def rendered(unknowns: Unknowns, key, spp: int) -> tuple[Layers, Array]:
            seen_by = pinhole
            if cameras:
                seen_by = pinhole._replace(to_world=corrected(pinhole.to_world, unknowns.cameras[photograph.number]))
            camera = seen_by.camera(film)
            scene = scene_of(mesh, unknowns, camera)
            return layers(scene, camera, key, division.samples(spp), integrator), unknowns.exposure[photograph.number]

        shown = division.mean(rendered(unknowns, image_key, samples.image))

        def loss(parts, exposure):
            return picture_loss(parts, exposure, photograph, mask_weight)

        value, cotangents = jax.value_and_grad(loss, argnums=(0, 1))(*shown)
        _, pullback = jax.vjp(lambda unknowns: rendered(unknowns, derivative_key, samples.gradient), unknowns)
        parts = shown[0]
        picture = parts.full if photograph.alpha is None else parts.over_black
        return value, division.mean(pullback(cotangents)[0]), jnp.concatenate([picture, parts.alpha[..., None]], -1)

    return gradient


class Expected(NamedTuple):
    """What the priors need: `neighbours`, rows of the albedo, that is, edges of the mesh or pairs of texels; shares of
    the sphere of the light's rows, and its backdrop or zeros."""

    neighbours: Int[Array, "E 2"]
    solid_angles: Float[Array, "H 1"]
    radiance: Float[Array, "H W 3"]
    weight: Float[Array, "H W"]
    clipped: Float[Array, "H W"]


def prior_loss(unknowns: Unknowns, expected: Expected, weights: Priors) -> Float[Array, ""]:
    """The weighted sum of the priors: see `Priors`."""
    albedo, light = reflectance(unknowns.albedo).reshape(-1, 3), unknowns.light
    a, b = expected.neighbours[:, 0], expected.neighbours[:, 1]
    smooth = huber(albedo[a] - albedo[b], JUMP).mean()
    even = huber(light - jnp.roll(light, 1, axis=1), LAMP).mean() + huber(light[1:] - light[:-1], LAMP).mean()
    radiance = jnp.exp(light)
    grey = luminance(radiance)[..., None]
    mean = (grey * expected.solid_angles[..., None]).sum()
    white = (huber(radiance / mean - grey / mean, TINT).mean(-1) * expected.solid_angles).sum()
    (seen,) = without(expected.weight == 0, expected.radiance)
    error = radiance - seen
    error = jnp.where(expected.clipped[..., None] > 0, jnp.minimum(error, 0.0), error) * tone_weight(seen)
    known = (huber(error, OUTLIER).mean(-1) * expected.weight * expected.solid_angles).sum()
    # The mean exposure is the light's.
    level = (unknowns.exposure.mean(0) ** 2).sum()
    return (
        weights.albedo * smooth
        + weights.light * even
        + weights.white * white
        + weights.background * known
        + 0.1 * level
        + weights.cameras * (unknowns.cameras**2).mean()
    )
