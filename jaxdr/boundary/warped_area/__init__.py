"""`WarpedArea` (Xu et al. 2023): the boundary integral becomes the divergence of a velocity field over what is seen.

`occluders` finds what hides auxiliary points, and how near they are to the boundary. `continuous_velocity` mixes their
velocities with weights that grow towards the boundary. `outlines` keeps velocities inside faces. `divergence` combines
them with the contribution of the path. `estimator` is the term behind the first hit, `warped_camera` the term of the
camera's own segment.
"""

from jaxdr.boundary.warped_area.estimator import WarpedArea as WarpedArea
