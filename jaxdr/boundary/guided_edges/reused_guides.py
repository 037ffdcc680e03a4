"""Guides that are built once and used for many steps of an optimisation.

A guide is a density of primary numbers. The map from these to lines past edges belongs to the current scene. So the
density of the lines is known exactly, even if shapes moved since the guide was built. The guide only fits less well.
"""

from collections.abc import Collection
from functools import partial

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.guided_edges.edge_chains import EdgeOrder
from jaxdr.boundary.guided_edges.estimator import GuidedEdges, GuidedEdgesState
from jaxdr.boundary.guided_edges.primary_guides import Defended
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.shared.traits import Traits
from jaxdr.compilation import unfolded
from jaxdr.geometry.queries import check_rays
from jaxdr.scene.packed import pack
from jaxdr.scene.scene import Scene
from jaxdr.transport.path_settings import PathSettings
from jaxdr.whole_numbers import check_depth


class ReusedGuides(eqx.Module):
    """`GuidedEdges` with guides that `build_guides` has made: a boundary estimator for `PathTracer`.

    It is a pytree. All guides of the same sizes use one compiled program. `order` is the order of sorted edges, None
    without sorting. `edges` is the number of edges of the scene.
    """

    boundary: GuidedEdges = eqx.field(static=True)
    guides: tuple[Defended, ...]
    order: EdgeOrder | None
    edges: int = eqx.field(static=True)

    name = "boundary"

    def known_failure(self, found: Traits) -> str | None:
        """See `jaxdr.boundary.shared.traits`."""
        return self.boundary.known_failure(found)

    def prepare(self, context: Context, key: PRNGKeyArray) -> GuidedEdgesState:
        """Edges of the current scene, with these guides.

        Raises ValueError like `GuidedEdges.prepare`, and for guides of another mesh or depth.
        """
        del key
        _same_edges(context.packed.edges.vertices.shape[0], self.edges)
        scene = context.packed, context.moving.seen, context.settings
        return self.boundary.prepare_with(*scene, self.guides, self.order)

    def draw(self, context: Context, state: GuidedEdgesState, chunk: Chunk, key: PRNGKeyArray):
        """See `GuidedEdges.draw`."""
        return self.boundary.draw(context, state, chunk, key)

    def image(self, context: Context, state: GuidedEdgesState, chunk: Chunk, held, answers) -> Float[Array, "H W 3"]:
        """See `GuidedEdges.image`."""
        return self.boundary.image(context, state, chunk, held, answers)


@checked
def build_guides(
    scene: Scene,
    boundary: GuidedEdges,
    max_depth: int = 2,
    rays: str = "auto",
    moving: Collection[str] | None = None,
) -> ReusedGuides:
    """Build guides for many images of a scene: a boundary estimator for `PathTracer`.

    `boundary` says which guides, `max_depth` for which paths. `moving` names the shapes that move (None: all). Name the
    shapes by which you differentiate. Samples go to edges that move, and the guides fit other edges badly.

    Works under jit. Raises ValueError for names that the scene does not have, and for scenes that `GuidedEdges` does
    not cover.
    """
    settings, flags = checked_settings("build_guides", scene, max_depth, rays, moving)
    guides, order = _built(scene, boundary, flags, settings)
    edges = sum(shape.mesh.edges.vertices.shape[0] for shape in scene.shapes.values())
    return ReusedGuides(boundary, guides, order, edges)


@checked
def refit_guides(
    scene: Scene,
    guides: ReusedGuides,
    key: PRNGKeyArray,
    max_depth: int = 2,
    rays: str = "auto",
    moving: Collection[str] | None = None,
) -> ReusedGuides:
    """Fit the densities of guides to the current scene. This takes less time than building guides.

    Boxes, leaves and the order of sorted edges stay as they are. `max_depth` and `moving` must be those that the guides
    were built with. `key` chooses where the target is evaluated.

    Works under jit. Raises ValueError like `build_guides`, and for guides of another mesh or depth.
    """
    settings, flags = checked_settings("refit_guides", scene, max_depth, rays, moving)
    _same_edges(sum(shape.mesh.edges.vertices.shape[0] for shape in scene.shapes.values()), guides.edges)
    return _refitted(scene, guides, key, flags, settings)


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


def checked_settings(
    caller: str, scene: Scene, max_depth: int, rays: str, names: Collection[str] | None
) -> tuple[PathSettings, tuple[bool, ...]]:
    """(settings of the paths that guides are for, which shapes are named; all if `names` is None).

    Raises ValueError for settings out of range, and names that the scene does not have.
    """
    check_depth(caller, max_depth)
    check_rays(caller, rays)
    unknown = sorted(set(names or ()) - set(scene.shapes))
    if unknown:
        known = ", ".join(scene.shapes)
        raise ValueError(f"{caller}: moving names {unknown[0]!r}, but the scene's shapes are {known}")
    return PathSettings(max_depth, True, rays), tuple(names is None or name in names for name in scene.shapes)
