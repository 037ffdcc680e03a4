"""Lights without area as tables, and the choice among all emitters of a scene by power."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.gather import rows_of
from jaxdr.scene.emitters import DirectionSampler
from jaxdr.scene.lights import DeltaLight
from jaxdr.scene.sampling import probabilities


class LightGroup(eqx.Module):
    """Lights of one kind, with their fields stacked, or one light alone.

    `member`: which lights of the scene are in it. `row`: the row of every light of the scene, 0 if it is not.
    """

    light: DeltaLight
    row: Int[Array, " D"]
    member: Bool[Array, " D"]
    stacked: bool = eqx.field(static=True)

    def at(self, index: Int[Array, " N"]) -> DeltaLight:
        """The lights of these numbers; meaningless for lights that are no members."""
        return jax.tree.map(lambda field: rows_of(field, self.row[index]), self.light) if self.stacked else self.light

    def powers(self, radius: Float[Array, ""]) -> Float[Array, " D"]:
        """Magnitude of the power of every light, zero for lights that are no members."""
        power = jax.vmap(lambda light: light.power(radius))(self.light) if self.stacked else self.light.power(radius)
        return jnp.where(self.member, power[self.row] if self.stacked else power, 0.0)


def group_lights(lights: list[DeltaLight]) -> tuple[LightGroup, ...]:
    """Groups of the lights. Lights of the same static structure share a group, those with borders or tables do not."""
    stacks = [light.stackable and light.borders() is None for light in lights]
    structures = [jax.tree.structure(light) if stacks[i] else i for i, light in enumerate(lights)]
    groups = []
    for structure in dict.fromkeys(structures):
        members = [i for i, s in enumerate(structures) if s == structure]
        light = lights[members[0]]
        if stacks[members[0]]:
            light = jax.tree.map(lambda *fields: jnp.stack(fields), *(lights[i] for i in members))
        row = np.zeros(len(lights), np.int32)
        row[members] = np.arange(len(members))
        member = np.isin(np.arange(len(lights)), members)
        groups.append(LightGroup(light, jnp.asarray(row), jnp.asarray(member), stacks[members[0]]))
    return tuple(groups)


def emitter_choice(
    size: Float[Array, ""],
    environment: DirectionSampler | None,
    surfaces: Float[Array, ""] | None,
    lights: tuple[LightGroup, ...],
) -> Float[Array, " K"]:
    """Cumulative probabilities, by power, of the environment, the surfaces and each light that there are; detached.

    `surfaces` is the area of the emitting surfaces times the magnitude of their radiance. Their power is pi times that.
    An environment of mean radiance L counts as pi R^2 L, with R the radius of the scene. The light through the scene's
    bounding sphere is 4 pi times as much, but most of it meets nothing. With this choice, a sky and a panel at a
    distance of R / 2 have about the same probability if they light a surface equally.
    """
    lights = jax.tree.map(stop_gradient, lights)
    radius = 0.5 * size
    powers = []
    if environment is not None:
        powers.append(math.pi * radius**2 * environment.mean()[None])
    if surfaces is not None:
        powers.append(math.pi * surfaces[None])
    if lights:
        powers.append(sum(group.powers(radius) for group in lights))
    cumulative = jnp.cumsum(probabilities(jnp.concatenate(powers)))
    return stop_gradient(cumulative / cumulative[-1])
