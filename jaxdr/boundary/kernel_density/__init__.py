"""`KernelDensity` (Xu et al. 2026): path segments that pass near a silhouette stand for those that touch it.

`estimator` is the term: edges near each segment are found among those of `moving_edges`, projected, checked by a ray,
and weighted by a kernel over `strips`. `lobe_kernel` is the same over directions that BSDFs sample, with the background
traced. `plain_kernel` is what belongs to the paper alone: points on edges, radii that shrink.
"""

from jaxdr.boundary.kernel_density.estimator import KernelDensity as KernelDensity
