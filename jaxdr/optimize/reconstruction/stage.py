"""A level of a reconstruction: its mesh, photographs, and what is compiled for it."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from jaxdr.compilation import jit
from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.devices import Device, Divided, divide
from jaxdr.optimize.preconditioner import LargeSteps
from jaxdr.optimize.processes import mesh_of_writer
from jaxdr.optimize.reconstruction.atlas import at_vertices, covered, neighbours, unwrapped
from jaxdr.optimize.reconstruction.config import Level, ReconstructConfig
from jaxdr.optimize.reconstruction.objective import Expected, Photograph, prior_loss, view_gradient
from jaxdr.optimize.reconstruction.paint import (
    ROWS,
    detailed,
    first_light_and_albedo,
    painted,
    seen_colors,
)
from jaxdr.optimize.reconstruction.photo_set import PhotoSet
from jaxdr.optimize.reconstruction.pictures import Photographs
from jaxdr.optimize.reconstruction.seen_points import point_loss
from jaxdr.optimize.reconstruction.sky import Backdrop, resampled, solid_angles
from jaxdr.optimize.reconstruction.unknowns import (
    ROUGHEST,
    SMOOTHEST,
    State,
    Unknowns,
    carried,
    from_latent,
    optimizer,
    reflectance,
    to_latent,
)
from jaxdr.optimize.remesh import remesh_to

FIRST_ROUGHNESS = 0.5
DIM = 0.02  # of the mean: the darkest light to start with; logarithms of less take long to come back


class Stage(NamedTuple):
    """What stays the same during a level.

    - `mesh`: its topology, at the positions it began with; `start`: steps done by then; `number`: of the level.
    - `steps`: preconditioner; `transformation`: optimiser; `photographs`: of the fitted views.
    - `gradient`: `view_gradient` of ((mesh, unknowns), views), compiled.
    - `update`: compiled (state, gradient by the unknowns) -> state.
    """

    number: int
    start: int
    mesh: Mesh
    steps: LargeSteps
    transformation: optax.GradientTransformation
    photographs: Photographs
    gradient: Divided
    update: Callable

    def unknowns(self, state: State) -> Unknowns:
        """The unknowns as they are now."""
        return from_latent(self.steps, state.latent)

    def fresh(self, unknowns: Unknowns) -> State:
        """The state with these unknowns, and optimisers that begin."""
        latent = to_latent(self.steps, unknowns)
        return State(latent, self.transformation.init(latent))

    def current_mesh(self, state: State) -> Mesh:
        """The mesh as it is now."""
        return self.mesh.with_vertices(self.unknowns(state).vertices)

    def photograph(self, view: int) -> Photograph:
        """What a view is compared with."""
        cut = self.photographs[view]
        alpha = None if cut.alpha is None else jnp.asarray(cut.alpha)
        color, trust, framed = (jnp.asarray(pixels) for pixels in (cut.color, cut.trust, cut.framed))
        return Photograph(color, alpha, trust, jnp.asarray(view, jnp.int32), framed)


def make_stage(
    config: ReconstructConfig, photos: PhotoSet, number: int, start: int, mesh: Mesh, devices: Sequence[Device]
) -> Stage:
    """A level for a mesh."""
    level = config.levels[number]
    steps = LargeSteps(mesh, level.lam)
    transformation = optimizer(config.rates, config.unknown, config.steps, start)
    expected = _expected(mesh, photos.backdrop(level.sky), level)
    weights = config.priors

    def beside(unknowns: Unknowns) -> Float[Array, ""]:
        loss = prior_loss(unknowns, expected, weights)
        if photos.seen is not None:
            loss += weights.points * point_loss(mesh, unknowns.vertices, photos.seen)
        return loss

    @jit
    def update(state: State, gradient: Unknowns) -> State:
        prior = jax.grad(beside)(from_latent(steps, state.latent))
        total = from_latent(steps, jax.tree.map(jnp.add, gradient, prior))
        updates, moments = transformation.update(total, state.optimizer, state.latent)
        return State(jax.tree.map(jnp.add, state.latent, updates), moments)

    samples, views = config.samples, min(level.views, len(photos.views))
    division = divide(views, len(devices), min(samples.image, samples.gradient))
    cameras = "cameras" in config.unknown
    of_view = view_gradient(config.integrator.build(), samples, config.priors.mask, division, cameras)
    gradient = Divided(lambda common, view: of_view(*common, *view), division, devices)
    return Stage(number, start, mesh, steps, transformation, photos.at(level.resolution), gradient, update)


def _expected(mesh: Mesh, backdrop: Backdrop | None, level: Level) -> Expected:
    angles = solid_angles(level.sky)
    columns = 2 * (level.sky - 1)
    if backdrop is None:
        nothing = np.zeros((level.sky, columns))
        backdrop = Backdrop(np.ones((level.sky, columns, 3)), nothing, nothing)
    pairs = neighbours(covered(mesh, level.texture), level.texture) if level.texture else mesh.edges.vertices
    return Expected(jnp.asarray(pairs, jnp.int32), *(jnp.asarray(x, float) for x in (angles, *backdrop)))


def mesh_of_level(level: Level, make: Callable[[], Mesh]) -> Mesh:
    """The mesh that the writing process makes, smooth, with texture coordinates if the level has a texture."""

    def ready() -> Mesh:
        mesh = make().smooth()
        return unwrapped(mesh, level.texture) if level.texture else mesh

    return mesh_of_writer(ready)


def first_unknowns(config: ReconstructConfig, photos: PhotoSet, mesh: Mesh) -> Unknowns:
    """The paint and the light that explain the dull colours that photographs show, half rough."""
    count, level = len(mesh.vertices), config.levels[0]
    seen = seen_colors(mesh, photos.paint())
    radiance, albedo = first_light_and_albedo(mesh, seen, photos.backdrop(ROWS))
    if level.texture:
        albedo = painted(mesh, albedo, seen, photos.paint(), level.texture)
    radiance = np.maximum(radiance, DIM * radiance.mean())
    roughness = (FIRST_ROUGHNESS - SMOOTHEST) / (ROUGHEST - SMOOTHEST)
    values = (
        np.asarray(mesh.vertices),
        _logit(albedo),
        np.full((count, 1), _logit(roughness)),
        resampled(np.log(radiance), level.sky),
        photos.exposure,
        np.zeros((len(photos.views), 6)),
    )
    return Unknowns(*(jnp.asarray(value, float) for value in values))


def _logit(share):
    return np.log(share / (1 - share))


def next_unknowns(
    config: ReconstructConfig, photos: PhotoSet, number: int, mesh: Mesh, unknowns: Unknowns
) -> tuple[Mesh, Unknowns, str]:
    """(the mesh remeshed for a level, the unknowns carried over, why remeshing failed or nothing: then it is the same).

    A finer mesh and a texture show more of the paint: what photographs show of it, relative to what the mesh before
    could hold of that, multiplies the albedo.
    """
    level = config.levels[number]
    light = jnp.asarray(resampled(np.asarray(unknowns.light), level.sky), float)
    albedo, roughness = unknowns.albedo, unknowns.roughness
    if albedo.ndim == 3:
        albedo = at_vertices(mesh, albedo)
    cameras = unknowns.cameras if "cameras" in config.unknown else None
    photographs = partial(photos.paint, cameras, np.asarray(unknowns.exposure, float))
    problem = ""
    try:
        new = mesh_of_level(level, lambda: remesh_to(mesh, level.vertices))
    except ValueError as refused:
        problem, new = str(refused), mesh
        if level.texture:
            new = mesh_of_level(level, lambda: mesh)
    seen = cache(lambda: seen_colors(new, photographs()))
    if not problem:
        old_seen = seen_colors(mesh, photographs())
        albedo, roughness, blurred = carried(mesh, new, reflectance(jnp.asarray(albedo)), roughness, old_seen)
        albedo = _logit(detailed(albedo, seen(), blurred))
    if level.texture:
        shares = np.asarray(reflectance(jnp.asarray(albedo)))
        albedo = _logit(painted(new, shares, seen(), photographs(), level.texture))
    values = (new.vertices, albedo, roughness, light, unknowns.exposure, unknowns.cameras)
    return new, Unknowns(*(jnp.asarray(value, float) for value in values)), problem
