"""The unknowns, as numbers that stay meaningful after any step, and the scene they stand for."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.adam import adam_uniform
from jaxdr.optimize.preconditioner import LargeSteps
from jaxdr.optimize.reconstruction.config import Rates
from jaxdr.optimize.reconstruction.sky import environment
from jaxdr.scene.bsdf import Principled
from jaxdr.scene.camera import Camera
from jaxdr.scene.scene import Scene, Shape
from jaxdr.scene.textures import Bitmap, VertexColors

OBJECT = "object"
ROUGHEST, SMOOTHEST = 1.0, 0.05


class Unknowns(NamedTuple):
    """Vertices; logits of albedo and roughness; logarithms of the light and of the exposures of N photographs.

    `albedo` is at the vertices [V, 3], or a texture [S, S, 3] over the texture coordinates of the mesh. `roughness` is
    at the vertices: highlights tell of it, which are few and large, so it has to be smooth. `cameras`: corrections of
    their poses, see `cameras.corrected`; shifts are in units of the object's longest side.
    """

    vertices: Float[Array, "V 3"]
    albedo: Float[Array, "*P 3"]
    roughness: Float[Array, "V 1"]
    light: Float[Array, "H W 3"]
    exposure: Float[Array, "N 3"]
    cameras: Float[Array, "N 6"]


class State(NamedTuple):
    """What a step changes: unknowns, with vertices and roughness in latent coordinates, and the optimisers' moments."""

    latent: Unknowns
    optimizer: optax.OptState


def reflectance(logits: Float[Array, "*P 3"]) -> Float[Array, "*P 3"]:
    """Albedo in (0, 1)."""
    return jax.nn.sigmoid(logits)


def roughness_of(logits: Float[Array, "V 1"]) -> Float[Array, " V"]:
    """Roughness between 0.05 and 1."""
    return SMOOTHEST + (ROUGHEST - SMOOTHEST) * jax.nn.sigmoid(logits[:, 0])


def scene_of(mesh: Mesh, unknowns: Unknowns, camera: Camera) -> Scene:
    """The scene: an object of a principled material that is no metal, under a sky."""
    albedo = reflectance(unknowns.albedo)
    paint = VertexColors(albedo) if albedo.ndim == 2 else Bitmap(albedo)
    bsdf = Principled(paint, 0.0, VertexColors(roughness_of(unknowns.roughness)[:, None]))
    shape = Shape(mesh.with_vertices(unknowns.vertices), bsdf)
    return Scene({OBJECT: shape}, camera, environment(unknowns.light))


def optimizer(rates: Rates, unknown: Sequence[str], steps: int, start: int) -> optax.GradientTransformation:
    """One transformation for all: `adam_uniform` for vertices and roughness, Adam for the rest, nothing for what is
    known. Step sizes fall over `steps`, of which `start` are done."""

    def rate(name: str) -> optax.Schedule:
        first = getattr(rates, name)
        decay = optax.exponential_decay(first, steps, rates.final)
        return lambda count: decay(count + start)

    made: dict[Any, Any] = {"vertices": adam_uniform(rate("vertices"))}
    for name in Unknowns._fields[1:]:
        if name not in unknown:
            made[name] = optax.set_to_zero()
        elif name == "roughness":
            made[name] = adam_uniform(rate(name))
        else:
            made[name] = optax.adam(rate(name), b2=0.99, eps=1e-6)
    labels: Any = Unknowns(*Unknowns._fields)  # type: ignore[arg-type]
    return optax.partition(made, labels)


def to_latent(steps: LargeSteps, unknowns: Unknowns) -> Unknowns:
    """The unknowns, with vertices and roughness in latent coordinates."""
    return unknowns._replace(vertices=steps.to_latent(unknowns.vertices), roughness=steps.to_latent(unknowns.roughness))


def from_latent(steps: LargeSteps, latent: Unknowns) -> Unknowns:
    """The unknowns. The map is symmetric: it takes gradients by unknowns to gradients by latent coordinates, too."""
    both = steps.from_latent(jnp.concatenate([latent.vertices, latent.roughness], 1))
    return latent._replace(vertices=both[:, :3], roughness=both[:, 3:])


def carried(old: Mesh, new: Mesh, *values: Float[np.ndarray | Array, "V _"]) -> list[Float[np.ndarray, "W _"]]:
    """Values at the vertices of a mesh, carried to those of another: of the three nearest, by inverse distance."""
    from scipy.spatial import KDTree

    distance, nearest = KDTree(np.asarray(old.vertices, float)).query(np.asarray(new.vertices, float), k=3)
    weight = 1 / np.maximum(distance, 1e-6)
    weight = (weight / weight.sum(1, keepdims=True))[..., None]
    return [(weight * np.asarray(value, float)[nearest]).sum(1) for value in values]
