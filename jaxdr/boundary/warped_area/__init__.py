"""`WarpedArea` (Xu et al. 2023): the boundary becomes the divergence of a velocity inside of what is seen.

`occluders` tells what hides auxiliary points and how near they are to the boundary; `continuous_velocity` mixes their
velocities with weights that grow there, `outlines` keeps them inside of faces; `divergence` multiplies by what the path
carries. `estimator` is the term behind the first hit, `warped_camera` that of the camera's own segment.
"""

from jaxdr.boundary.warped_area.estimator import WarpedArea as WarpedArea
