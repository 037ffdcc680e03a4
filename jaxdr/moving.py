"""Which parts of a scene move in a derivative; known when the program is traced."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxdr.chunked_sum import dependent
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.packed import group_bsdfs
from jaxdr.scene.scene import Scene, Shape, unwrap
from jaxdr.scene.textures import TexturePoint


class Moving(NamedTuple):
    """Which parts of a scene move in a derivative. Static: known when the program is traced.

    - `shapes`: one flag for each of `scene.shapes`, in their order. A shape also counts as moving if the index of its
      smooth glass, or the normals of its mirror, are differentiated.
    - `camera`: whether the camera moves.
    - `lights`: one flag for each of `scene.lights`.
    - `environment`: whether the environment turns.
    - `scattering`: whether parameters of BSDFs are differentiated. They need not move anything, but a path whose
      throughput is zero may have a derivative by them.
    """

    shapes: tuple[bool, ...]
    camera: bool
    lights: tuple[bool, ...] = ()
    environment: bool = False
    scattering: bool = True

    @property
    def seen(self) -> tuple[bool, ...]:
        """Which shapes move relative to the camera."""
        return (True,) * len(self.shapes) if self.camera else self.shapes

    @property
    def any(self) -> bool:
        """Whether visibility can change at all."""
        return any(self.seen) or any(self.lights) or self.environment


def moving_in(scene: Scene, active: Scene) -> Moving:
    """Which parts of a scene move. The leaves of `active` say which floats are differentiated.

    Methods of the parts are traced. A part moves if their results depend on active floats. So there is no list of
    parameters that could be incomplete.
    """
    sky = scene.environment
    return Moving(
        shapes=tuple(_moves(shape, flags) for shape, flags in _pairs(scene.shapes, active.shapes)),
        camera=any(jax.tree.leaves(active.camera)),
        lights=tuple(_changes(_shadow_lines, *pair) for pair in _pairs(scene.lights, active.lights)),
        environment=sky is not None and _changes(lambda sky: sky.turn(), sky, active.environment),
        scattering=any(jax.tree.leaves([shape.bsdf for shape in active.shapes.values()])),
    )


def _moves(shape: Shape, active: Shape) -> bool:
    bsdf = unwrap(shape.bsdf)
    return bool(active.mesh.vertices) or (bsdf.delta and _changes(_lobe, bsdf, unwrap(active.bsdf)))


def _changes(what: Callable[[Any], Any], part: Any, active: Any) -> bool:
    """Whether `what(part)` has a derivative by the active leaves of the part."""
    at, fixed = eqx.partition(part, active)
    return any(dependent(lambda at: jax.tree.leaves(what(eqx.combine(at, fixed))), at))


def _shadow_lines(light):
    """The properties of a light on which the places of its shadows depend."""
    return light.place(), light.borders()


def _lobe(bsdf: BSDF):
    """Direction of a delta lobe at one point. If it changes, the reflected or refracted scene moves in the image."""
    third, none = jnp.full((1, 3), 1.0 / 3.0), jnp.zeros(1, jnp.int32)
    point = TexturePoint(third[:, :2], third, jnp.zeros((1, 3), jnp.int32), none, jnp.ones((1, 3)))
    (group,) = group_bsdfs([bsdf])
    return group.at(none, point).sample_delta(third, third[:, :2]).wo


def _pairs(one: dict, two: dict):
    return zip(one.values(), two.values(), strict=True)
