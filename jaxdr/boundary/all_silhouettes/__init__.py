"""All silhouettes that a path vertex sees, without a random choice among them: docs/all_silhouettes.md.

`estimator` is the term. A query lists the silhouettes of every vertex, and each gets a point, a ray and a path.
"""

from jaxdr.boundary.all_silhouettes.estimator import AllSilhouettes as AllSilhouettes
