"""The frame of the asset: upright, on y = 0, in metres where they are known. glTF has y up, and the front at +z."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxdr.optimize.reconstruction.config import Asset
from jaxdr.optimize.reconstruction.sky import TO_WORLD, directions
from jaxdr.optimize.reconstruction.upright import upright
from jaxdr.scene.environment_map import EnvironmentMap
from jaxdr.views.record import View, Views

STEEP = 0.99  # sine of the height of the cameras from which on no side is the front


class AssetFrame(NamedTuple):
    """The similarity from the world of the cameras: `rotation` (its rows are the axes), `scale`, then `shift`."""

    rotation: Float[np.ndarray, "3 3"]
    scale: float
    shift: Float[np.ndarray, "3"]

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "V 3"], views: Sequence[View], asset: Asset) -> "AssetFrame":
        """Up is +y, and the lowest vertex at y = 0. The middle is at x = z = 0. Most cameras are on the side of +z."""
        up = upright(views) if asset.direction is None else np.asarray(asset.direction)
        up = up / np.linalg.norm(up)
        rotation = _axes(up, np.mean([view.to_world[:3, 3] for view in views], axis=0) - vertices.mean(0))
        turned = vertices @ rotation.T
        low, high = turned.min(0), turned.max(0)
        scale = asset.scale or (asset.height / float(high[1] - low[1]) if asset.height else 1.0)
        feet = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
        return cls(rotation, scale, -scale * feet)

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """The similarity as a matrix for columns."""
        made = np.eye(4)
        made[:3, :3], made[:3, 3] = self.scale * self.rotation, self.shift
        return made

    def points(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Points of the world in this frame."""
        return self.scale * points @ self.rotation.T + self.shift

    def views(self, views: Views) -> Views:
        """The photographs with cameras in this frame."""
        return replace(views, views=tuple(replace(v, to_world=self.pose(v.to_world)) for v in views.views))

    def pose(self, to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """A camera in this frame: its axes stay unit vectors."""
        made = np.eye(4)
        made[:3, :3], made[:3, 3] = self.rotation @ to_world[:3, :3], self.points(to_world[None, :3, 3])[0]
        return made

    def light(self, radiance: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
        """A map of the light whose own frame is this one, from one as `sky.environment` has it; bilinear."""
        towards = directions(len(radiance)) @ self.rotation
        return np.asarray(EnvironmentMap(radiance, TO_WORLD).eval(jnp.asarray(towards, float)))


def _axes(up: Float[np.ndarray, "3"], front: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rows: to the right, up, to the front as far as that is level."""
    size = np.linalg.norm(front)
    if size == 0 or abs(front @ up) > STEEP * size:
        front = np.eye(3)[np.argmin(np.abs(up))]
    front = front - (front @ up) * up
    front = front / np.linalg.norm(front)
    return np.stack([np.cross(up, front), up, front])
