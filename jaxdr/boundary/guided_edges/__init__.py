"""`GuidedEdges` (Zhang et al. 2020; Yan et al. 2022): boundary segments past edges, joined to both ends of a path.

Three primary numbers choose a point on an edge and a direction. `edge_chains` orders the edges. `edge_lunes` holds the
directions in which each is a silhouette. `boundary_segments` draws the segments, `plan_lines` those of all strategies
at once, and `beam` connects them to the film.
A guide is a density of the primary numbers: `primary_guides` (none, a grid), `kdtree_guide`, or `seeded_tree` with
seeds from `projected_paths`. `guide_target` and `flux_maps` hold the function that guides approximate. `estimator` is
the term. `reused_guides` keeps guides for later images.
"""

from jaxdr.boundary.guided_edges.estimator import GuidedEdges as GuidedEdges
