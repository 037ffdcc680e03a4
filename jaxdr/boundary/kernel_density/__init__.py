"""`KernelDensity` (Xu et al. 2026): path segments that pass near a silhouette stand for those that touch it.

`estimator` is the term. It finds edges near each segment, projects them, checks them by a ray, and weights them by a
kernel over `strips`. With `moving_edges`, segments at rest leave out edges at rest. `lobe_kernel` has the kernel over
directions that BSDFs sample, with a ray for the background. `plain_kernel` has what only the paper's method needs:
points on edges, and radii that shrink.
"""

from jaxdr.boundary.kernel_density.estimator import KernelDensity as KernelDensity
