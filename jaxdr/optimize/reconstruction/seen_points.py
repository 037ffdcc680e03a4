"""Points of the object that photographs saw, and how far the surface is from them there."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from jaxdr.compilation import jit
from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.queries import Geometry, Rays, closest_hit
from jaxdr.geometry.vector import dot
from jaxdr.optimize.adam import adam_uniform
from jaxdr.optimize.preconditioner import LargeSteps
from jaxdr.optimize.reconstruction.evenly import evenly
from jaxdr.optimize.reconstruction.objective import huber
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.views.record import Views, in_mask
from jaxdr.views.sparse_points import SparsePoints

OWN = 0.8  # share of the photographs that saw a point and have it inside of their masks: then it is the object's
MOST = 1 << 14  # rays; more cost time and tell little
FEW = 50  # fewer rays tell nothing
WIDTH = 0.02  # of the longest side: distances well beyond it count by their size
FAR = 1e30
# Of the steps that take a first surface to the points: how many, their size, smoothness, and what is left of the size.
STEPS, RATE, LAM, FINAL = 200, 0.1, 16.0, 0.1


class SeenPoints(NamedTuple):
    """Rays from cameras to points of the object that they saw, in the frame of the object."""

    origin: Float[Array, "N 3"]
    point: Float[Array, "N 3"]


Rows = tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]  # places of cameras, points


def in_frame(found: Sequence[tuple[np.ndarray, np.ndarray]], pose: Pose) -> Rows:
    """Rows of several sources one after the other, from the world to the frame of the object."""
    origin, point = (np.concatenate(each) for each in zip(*found, strict=True))
    return (origin - pose.centre) / pose.scale, (point - pose.centre) / pose.scale


def seen_points(origin: Float[np.ndarray, "N 3"], point: Float[np.ndarray, "N 3"]) -> SeenPoints | None:
    """Rays in the frame of the object, some of them if there are many; None where there are few."""
    if len(point) < FEW:
        return None
    chosen = evenly(len(point), MOST)
    return SeenPoints(jnp.asarray(origin[chosen], float), jnp.asarray(point[chosen], float))


def of_sparse_points(views: Views, points: SparsePoints | None) -> Rows:
    """(places of cameras, sparse points they saw) of the points that are inside of the masks of fitted photographs."""
    if points is None:
        return np.zeros((0, 3)), np.zeros((0, 3))
    saw = points.saw & ~np.array([view.held_out for view in views.views])[:, None]
    inside = np.zeros_like(saw)
    for view, rows, found in zip(views.views, saw, inside, strict=True):
        if rows.any():
            found[rows] = in_mask(view, points.positions[rows])
    own = inside.sum(0) >= OWN * np.maximum(saw.sum(0), 1)
    camera, point = np.nonzero(saw & own)
    places = np.stack([view.to_world[:3, 3] for view in views.views])
    return places[camera], points.positions[point]


def point_loss(mesh: Mesh, vertices: Float[Array, "V 3"], seen: SeenPoints) -> Float[Array, ""]:
    """Mean robust squared distance of seen points from the planes of the faces that the cameras see in their place.

    A face in front of a point moves back to it, one behind comes forward, along its normal. Where a ray meets no face
    there is no loss: masks tell about outlines. The normals count as known, as in the registration of scans.
    """
    direction = seen.point - seen.origin
    hit = closest_hit(Geometry(vertices, mesh.faces), Rays(seen.origin, direction, jnp.full(len(direction), FAR)))
    found = hit.face >= 0
    corners = vertices[mesh.faces[jnp.where(found, hit.face, 0)]]
    a, b, c = jax.lax.stop_gradient((corners[:, 0], corners[:, 1], corners[:, 2]))
    normal = jnp.cross(b - a, c - a)
    length = jnp.sqrt(jnp.maximum(dot(normal, normal), 1e-30))
    on_face = (hit.barycentric[..., None] * corners).sum(1)
    distance = dot(normal / length[:, None], seen.point - on_face)
    return huber(jnp.where(found, distance, 0.0), WIDTH).mean()


def settled(mesh: Mesh, seen: SeenPoints) -> Mesh:
    """A first surface, moved smoothly to the points: a visual hull bulges where the object is hollow."""
    steps = LargeSteps(mesh, LAM)
    transformation = adam_uniform(optax.exponential_decay(RATE, STEPS, FINAL))

    @jit
    def step(latent: Float[Array, "V 3"], moments: optax.OptState):
        gradient = jax.grad(lambda vertices: point_loss(mesh, vertices, seen))(steps.from_latent(latent))
        updates, moments = transformation.update(steps.from_latent(gradient), moments)
        return optax.apply_updates(latent, updates), moments

    latent = steps.to_latent(mesh.vertices)
    moments = transformation.init(latent)
    for _ in range(STEPS):
        latent, moments = step(latent, moments)
    # Made anew: the order of its edges follows from its vertices, for a run that is resumed as well.
    return Mesh(np.asarray(steps.from_latent(latent)), np.asarray(mesh.faces))
