"""Earlier estimators, for comparison. Each has a file.

`redner_was` is `RednerWAS` (Bangaru et al. 2020): warped areas on the sphere of directions, direct light only. It uses
the velocity fields of `warped_area`.
"""

from jaxdr.boundary.baselines.redner_was import RednerWAS as RednerWAS
