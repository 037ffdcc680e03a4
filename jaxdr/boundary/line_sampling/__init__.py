"""`LineSampling` (ours): random chords through path vertices, and every silhouette that crosses one. No radius.

`estimator` is the term. It spends chords where a pilot found crossings. `chords` has the kinds of chords and the
weights of boundary points on them. `crossings` finds the edges that cross chords. Chords lie on area emitters
(`emitter_lines`), point to emitters of many faces (`lamp_lines`) or to the sky (`sky_lines`), or lie around BSDF
samples (`lobe_lines`).
"""

from jaxdr.boundary.line_sampling.estimator import LineSampling as LineSampling
