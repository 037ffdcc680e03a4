"""Silhouette edges of every path vertex, drawn from a tree with bounds in dual space (Soroka et al. 2025).

`estimator` is the term. `silhouette_tree` has the tree and its random descent, `dual_bounds` the test that finds parts
of a mesh without silhouettes, `importance` how likely a node is drawn.
"""

from jaxdr.boundary.baselines.quadric_sampling.estimator import QuadricSampling as QuadricSampling
