"""`GuidedEdges` (Zhang et al. 2020; Yan et al. 2022): lines past edges, from the edge to both ends of a path.

Primary numbers become a point on an edge and a direction: `edge_chains` orders the edges, `edge_lunes` holds where each
is a silhouette, `boundary_segments` draws, `beam` connects to the film. Guides are densities of these numbers:
`primary_guides` (none, a grid), `kdtree_guide`, `seeded_tree` with seeds of `projected_paths`; `guide_target` and
`flux_maps` are what they are made for. `estimator` is the term. `reused_guides` keeps guides.
"""

from jaxdr.boundary.guided_edges.estimator import GuidedEdges as GuidedEdges
