"""What a guide costs: its memory, and the time to build it."""

import time
from collections.abc import Collection
from typing import NamedTuple

import jax

from jaxdr.argument_kinds import checked
from jaxdr.boundary.guided_edges.estimator import GuidedEdges
from jaxdr.boundary.guided_edges.reused_guides import build_guides, checked_settings
from jaxdr.compilation import jit
from jaxdr.scene.scene import Scene


class GuideReport(NamedTuple):
    """Costs of all guides of a `GuidedEdges`.

    - `bytes`: their memory.
    - `seconds`: time to build them. `first_seconds`: the same with compilation.
    - `unguided`: for every strategy, the share of segments that is drawn without its guide. If it is near 1, the guide
      found too little to be of use: another guide, more evaluations or another strategy may find more.
    """

    bytes: int
    seconds: float
    first_seconds: float
    unguided: tuple[float, ...]


@checked
def guide_report(
    scene: Scene,
    boundary: GuidedEdges,
    max_depth: int = 2,
    rays: str = "auto",
    moving: Collection[str] | None = None,
) -> GuideReport:
    """What the guides of a scene cost, and how much they are used: a `GuideReport`.

    The guides are built twice, to time them without compilation. `boundary` says which guides, `moving` names the
    shapes that move (None: all).

    Raises ValueError for names that the scene does not have, and for scenes that `GuidedEdges` does not cover.
    """
    checked_settings("guide_report", scene, max_depth, rays, moving)
    build = jit(lambda scene: build_guides(scene, boundary, max_depth, rays, moving).guides)
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        guides = jax.block_until_ready(build(scene))
        seconds.append(time.perf_counter() - start)
    memory = sum(leaf.nbytes for g in guides for leaf in jax.tree.leaves(g.guide))
    return GuideReport(memory, seconds[1], seconds[0], tuple(float(g.share) for g in guides))
