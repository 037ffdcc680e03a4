"""What moves in a derivative: known when its program is traced."""

from typing import NamedTuple

import jax

from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.base import nested
from jaxdr.scene.scene import Scene, unwrap

# Parameters of lights without area that move their shadows.
PLACES = ("position", "direction", "to_world", "fov")


class Moving(NamedTuple):
    """Which parts of a scene move in a derivative. Static: known when the program is traced.

    - `shapes`: one flag for each of `scene.shapes`, in their order. A shape also counts as moving where the index of
      its smooth glass, or the normals of its mirror, are differentiated.
    - `camera`: whether the camera moves.
    - `lights`: one flag for each of `scene.lights`.
    - `environment`: whether the environment turns.
    """

    shapes: tuple[bool, ...]
    camera: bool
    lights: tuple[bool, ...] = ()
    environment: bool = False

    @property
    def seen(self) -> tuple[bool, ...]:
        """Which shapes move relative to the camera."""
        return (True,) * len(self.shapes) if self.camera else self.shapes

    @property
    def any(self) -> bool:
        """Whether visibility can change at all."""
        return any(self.seen) or any(self.lights) or self.environment


def moving_in(active: Scene) -> Moving:
    """Which geometry moves, from a scene whose leaves say whether they are differentiated."""
    return Moving(
        shapes=tuple(bool(shape.mesh.vertices) or _bends(unwrap(shape.bsdf)) for shape in active.shapes.values()),
        camera=any(jax.tree.leaves(active.camera)),
        lights=tuple(any(getattr(light, name, False) for name in PLACES) for light in active.lights.values()),
        environment=bool(getattr(active.environment, "to_world", False)),
    )


def _bends(active: BSDF) -> bool:
    """Whether directions of delta lobes change with the BSDF's own parameters, from one whose leaves say which do."""
    if not active.delta:
        return False
    own = any(jax.tree.leaves([getattr(active, name) for name in active.bending]))
    return own or any(map(_bends, nested(active)))
