"""Estimators for comparison. Each has a file or a folder.

`redner_was` is `RednerWAS` (Bangaru et al. 2020): warped areas on the sphere of directions, direct light only. It uses
the velocity fields of `warped_area`. `quadric_sampling` is `QuadricSampling` (Soroka et al. 2025): edges from a tree
that leaves out parts without silhouettes. `markov_chains` is `MarkovChains` (Xu et al. 2024): segments past edges, by
chains that walk along silhouettes. `walk_on_caps` is
`WalkOnCaps` (Wu et al. 2025): warped areas like `redner_was`, with velocities of the closest silhouettes;
`on_directions` is what both share.
"""

from jaxdr.boundary.baselines.markov_chains import MarkovChains as MarkovChains
from jaxdr.boundary.baselines.quadric_sampling import QuadricSampling as QuadricSampling
from jaxdr.boundary.baselines.redner_was import RednerWAS as RednerWAS
from jaxdr.boundary.baselines.walk_on_caps import WalkOnCaps as WalkOnCaps
