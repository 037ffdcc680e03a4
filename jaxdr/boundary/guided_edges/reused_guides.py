"""Guides that are built once and used for many steps of an optimisation.

A guide is a density of primary numbers, and the map from these to lines past edges is that of the shape of the moment:
whatever moved since the guide was built, the density of what is drawn is known exactly. What is lost is only how well
it fits.
"""

from collections.abc import Collection
from functools import partial

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.boundary.guided_edges.edge_chains import EdgeOrder
from jaxdr.boundary.guided_edges.estimator import GuidedEdges, GuidedEdgesState
from jaxdr.boundary.guided_edges.primary_guides import Defended
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.compilation import unfolded
from jaxdr.scene.packed import pack
from jaxdr.scene.scene import Scene
from jaxdr.transport.path import PathSettings


class ReusedGuides(eqx.Module):
    """`GuidedEdges` with guides that `build_guides` has made: a boundary estimator for `PathTracer`.

    It is a pytree. Guides of the same sizes go through one compiled program. The order of sorted edges is kept with
    them.
    """

    boundary: GuidedEdges = eqx.field(static=True)
    guides: tuple[Defended, ...]
    order: EdgeOrder | None
    edges: int = eqx.field(static=True)

    name = "boundary"

    def prepare(self, context: Context, key: PRNGKeyArray) -> GuidedEdgesState:
        """Edges of the shape of the moment.

        Raises ValueError as `GuidedEdges.prepare` does, and for guides of another mesh or depth.
        """
        del key
        _same_edges(context.packed.edges.vertices.shape[0], self.edges)
        scene = context.packed, context.moving.seen, context.settings
        return self.boundary.prepare_with(*scene, self.guides, self.order)

    def draw(self, context: Context, state: GuidedEdgesState, chunk: Chunk, key: PRNGKeyArray):
        """As `GuidedEdges.draw`."""
        return self.boundary.draw(context, state, chunk, key)

    def image(self, context: Context, state: GuidedEdgesState, chunk: Chunk, held, answers) -> Float[Array, "H W 3"]:
        """As `GuidedEdges.image`."""
        return self.boundary.image(context, state, chunk, held, answers)


def build_guides(
    scene: Scene,
    boundary: GuidedEdges,
    max_depth: int = 2,
    rays: str = "auto",
    moving: Collection[str] | None = None,
) -> ReusedGuides:
    """Guides of a scene that are kept: a boundary estimator for `PathTracer`.

    `boundary` says which guides, `max_depth` for which paths. `moving` names the shapes that move (None: all). Name
    those that you differentiate by: edges are spread by what moves, and guides fit others badly.

    Works under jit. Raises ValueError for names that the scene does not have, and for scenes that `GuidedEdges` does
    not cover.
    """
    settings = PathSettings(max_depth, True, rays)
    guides, order = _built(scene, boundary, _flags(scene, moving), settings)
    edges = sum(shape.mesh.edges.vertices.shape[0] for shape in scene.shapes.values())
    return ReusedGuides(boundary, guides, order, edges)


def refit_guides(
    scene: Scene,
    guides: ReusedGuides,
    key: PRNGKeyArray,
    max_depth: int = 2,
    rays: str = "auto",
    moving: Collection[str] | None = None,
) -> ReusedGuides:
    """Guides of the same sizes, fitted to the scene as it is now. It takes a part of the time of building them.

    Boxes and leaves stay as they are, and so does the order of sorted edges. `max_depth` and `moving` must be those
    that the guides were built with. `key` chooses where the target is evaluated.

    Works under jit. Raises ValueError as `build_guides` does, and for guides of another mesh or depth.
    """
    settings = PathSettings(max_depth, True, rays)
    _same_edges(sum(shape.mesh.edges.vertices.shape[0] for shape in scene.shapes.values()), guides.edges)
    return _refitted(scene, guides, key, _flags(scene, moving), settings)


@partial(jax.jit, static_argnums=(3, 4))
def _refitted(scene: Scene, guides: ReusedGuides, key, moving: tuple[bool, ...], settings: PathSettings):
    found = guides.boundary.refit(pack(unfolded(scene)), moving, settings, guides.guides, guides.order, key)
    return eqx.tree_at(lambda g: g.guides, guides, found)


def _same_edges(edges: int, built: int) -> None:
    if edges != built:
        raise ValueError(
            f"render: guides were built for a scene of {built} edges, and this one has {edges}; build them "
            "again with build_guides after remeshing"
        )


@partial(jax.jit, static_argnums=(1, 2, 3))
def _built(scene: Scene, boundary: GuidedEdges, moving: tuple[bool, ...], settings: PathSettings):
    prepared = boundary.build(pack(unfolded(scene)), moving, settings)
    return prepared.guides, prepared.order


def _flags(scene: Scene, names: Collection[str] | None) -> tuple[bool, ...]:
    """Which shapes of a scene are named; all without names. Raises ValueError for names that it does not have."""
    unknown = sorted(set(names or ()) - set(scene.shapes))
    if unknown:
        known = ", ".join(scene.shapes)
        raise ValueError(f"build_guides: moving names {unknown[0]!r}, but the scene's shapes are {known}")
    return tuple(names is None or name in names for name in scene.shapes)
