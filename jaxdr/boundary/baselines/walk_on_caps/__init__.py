"""`WalkOnCaps` (Wu et al. 2025): warped areas whose velocities come from walks to the closest silhouettes.

`caps` has points of spherical caps, and the gradient of a mean over a cap. `walks` walks from the emitter samples to
silhouettes, which gives velocities and their divergence. `estimator` is the term.
"""

from jaxdr.boundary.baselines.walk_on_caps.estimator import WalkOnCaps as WalkOnCaps
