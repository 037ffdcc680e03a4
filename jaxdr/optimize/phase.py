"""What an optimisation compiles for one topology and level: views, their gradients, and the step of the optimiser."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from jaxdr.compilation import jit
from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize import losses
from jaxdr.optimize.adam import adam_uniform
from jaxdr.optimize.config import Level, OptimizeConfig, Optimizer
from jaxdr.optimize.devices import ALONE, Device, Divided, Division, divide
from jaxdr.optimize.preconditioner import LargeSteps
from jaxdr.optimize.problem import OBJECT, Problem
from jaxdr.optimize.progress import NotFinite
from jaxdr.render import render
from jaxdr.scene.film import Film
from jaxdr.scene.scene import Scene, Shape


class State(NamedTuple):
    """What a step changes: latent coordinates of the vertices, and the optimiser's moments."""

    latent: Float[Array, "V 3"]
    optimizer: optax.OptState


class Programs(NamedTuple):
    """What is compiled for a level: functions of meshes, which are traced anew for another number of vertices or faces.

    - `image`: (mesh, camera-to-world, key, spp) -> image.
    - `gradient`: (mesh, views) -> losses of views and their gradients by the vertices; a view is (camera-to-world,
      target, key).
    """

    image: Callable
    gradient: Divided


class Phase(NamedTuple):
    """What stays the same as long as topology and level do.

    - `mesh`: the mesh when the topology last changed; `start`: number of steps done by then.
    - `level`: number of the level; `since`: number of steps done when it began.
    - `to_latent`, `from_latent`: of the preconditioner, the second one compiled.
    - `optimizer`: its learning rate goes on from `start`.
    - `image`: (vertices, camera-to-world, key, spp) -> image.
    - `gradients`: (vertices, views) -> [(loss, its gradient by the vertices)].
    - `update`: jitted (state, gradient by the vertices) -> state.
    """

    mesh: Mesh
    start: int
    level: int
    since: int
    to_latent: Callable
    from_latent: Callable
    optimizer: optax.GradientTransformation
    image: Callable
    gradients: Callable
    update: Callable

    def fresh_state(self) -> State:
        """The state at the start of the phase."""
        latent = self.to_latent(self.mesh.vertices)
        return State(latent, self.optimizer.init(latent))

    def vertices(self, state: State) -> Float[Array, "V 3"]:
        """Current vertex positions."""
        return self.from_latent(state.latent)

    def current_mesh(self, state: State) -> Mesh:
        """The mesh as it is now."""
        return self.mesh.with_vertices(self.vertices(state))


def make_programs(config: OptimizeConfig, problem: Problem, devices: Sequence[Device]) -> list[Programs]:
    """The programs of every level, compiled when they are called.

    Levels of the same resolution and samples, whose views are divided over the devices alike, share one.
    """
    made: dict[tuple, Programs] = {}
    found = []
    for stage in config.stages():
        division = divide(stage.views_per_step, len(devices), min(stage.image, stage.gradient))
        kind = (stage.resolution, stage.image, stage.gradient, division)
        if kind not in made:
            made[kind] = _programs(config, problem, stage, division, devices)
        found.append(made[kind])
    return found


def _programs(config: OptimizeConfig, problem: Problem, stage: Level, division: Division, devices) -> Programs:
    image = view_renderer(problem, stage.resolution)

    def gradient(mesh: Mesh, view):
        def moved(vertices, *arguments):
            return image(mesh.with_vertices(vertices), *arguments)

        of_view = view_gradient(moved, config.optimizer.loss, stage.image, stage.gradient, division)
        return of_view(mesh.vertices, *view)

    samples = config.samples.target, config.samples.pictures
    return Programs(in_pieces(image, samples), Divided(gradient, division, devices))


def make_phase(
    config: OptimizeConfig, programs: Programs, mesh: Mesh, start: int, level: int = 0, since: int = 0
) -> Phase:
    """The phase of a topology and level: its preconditioner and functions."""
    steps = LargeSteps(mesh, config.stages()[level].lam)
    optimizer = adam_uniform(learning_rate(config.optimizer, start))

    def image(vertices, *view):
        return programs.image(mesh.with_vertices(vertices), *view)

    def gradients(vertices, views):
        return programs.gradient(mesh.with_vertices(vertices), views)

    @jit
    def update(state: State, gradient: Float[Array, "V 3"]) -> State:
        # The system is symmetric: the pullback of from_latent is from_latent.
        updates, moments = optimizer.update(steps.from_latent(gradient), state.optimizer, state.latent)
        return State(jnp.asarray(optax.apply_updates(state.latent, updates)), moments)

    from_latent = jit(lambda latent: steps.from_latent(latent))
    return Phase(mesh, start, level, since, steps.to_latent, from_latent, optimizer, image, gradients, update)


def learning_rate(options: Optimizer, start: int) -> optax.Schedule:
    """Exponential decay over all iterations, for an optimiser whose count begins after `start` of them."""
    ratio = options.final_learning_rate / options.learning_rate
    decay = optax.exponential_decay(options.learning_rate, options.iterations, ratio)
    return lambda count: decay(count + start)


def view_renderer(problem: Problem, resolution: int) -> Callable:
    """Function (mesh, view's matrix, key, spp) -> square image of the scene with `mesh` as the object."""
    scene, integrator = problem.scene, problem.integrator
    old = scene.shapes[OBJECT]
    camera = dataclasses.replace(scene.camera, film=Film(resolution, resolution))

    def image(mesh, to_world, key, spp):
        turned = mesh.with_vertices(mesh.vertices @ to_world[:3, :3].T) if problem.turned else mesh
        shapes = {**scene.shapes, OBJECT: Shape(turned, old.bsdf, old.emitter)}
        viewed = Scene(shapes, camera, scene.environment, scene.lights)
        viewed = viewed if problem.turned else viewed.replace({"camera.to_world": to_world})
        return render(viewed, key, spp=spp, integrator=integrator)

    return image


def in_pieces(image: Callable, samples: Sequence[int]) -> Callable:
    """`image` (mesh, camera-to-world, key, spp), compiled once for all `samples` per pixel that are multiples of the
    fewest: more of them are the mean of several images."""
    program, least = jit(image, static_argnums=3), min(samples)

    def pieces(mesh, to_world, key, spp):
        if spp % least or spp == least:
            return program(mesh, to_world, key, spp)
        count = spp // least
        return sum(program(mesh, to_world, jax.random.fold_in(key, i), least) for i in range(count)) / count

    return pieces


def view_gradient(
    image: Callable, loss: str, image_spp: int, gradient_spp: int, division: Division = ALONE
) -> Callable:
    """Function (vertices, camera-to-world, target, key) -> loss of one view, and an unbiased estimate of its gradient.

    The loss is that of one image (two for `two_key_l2`) with `image_spp` samples per pixel. Its derivative by the
    image multiplies the derivative of another, independent rendering with `gradient_spp`: independent factors make
    the product unbiased, and two images that are alike in distribution can share it. Devices that share a view take
    part of the samples of each.
    """
    function, count = getattr(losses, loss), 2 if loss == "two_key_l2" else 1

    def gradient(vertices, to_world, target, key):
        *keys, derivative_key = (division.own_key(k) for k in jax.random.split(key, count + 1))
        images = [division.mean(image(vertices, to_world, k, division.samples(image_spp))) for k in keys]
        value, cotangents = jax.value_and_grad(lambda images: function(*images, target))(images)
        _, pullback = jax.vjp(lambda v: image(v, to_world, derivative_key, division.samples(gradient_spp)), vertices)
        return value, division.mean(pullback(sum(cotangents))[0])

    return gradient


def items_of_step(
    poses: Float[Array, "N 4 4"], targets: Float[np.ndarray, "N H W 3"], views: Sequence[int], key: PRNGKeyArray
) -> list[tuple]:
    """The (camera-to-world, target, key) of the views of a step, whose numbers are given."""
    keys = [jax.random.fold_in(key, slot) for slot in range(len(views))]
    return [(poses[view], jnp.asarray(targets[view]), own) for view, own in zip(views, keys, strict=True)]


def finite(tree: PyTree) -> bool:
    """Whether all numbers of a pytree of arrays are finite."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array)))


def check_finite(view: int, loss: Array, gradient: PyTree, step: int) -> None:
    """Raise `NotFinite` for the loss or gradient of a view that is not finite in a step."""
    wrong = [name for name, value in (("loss", loss), ("gradient", gradient)) if not finite(value)]
    if wrong:
        raise NotFinite(f"the {wrong[0]} of view {view} is not finite in step {step}")
