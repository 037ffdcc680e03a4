"""Boundary segments by Markov chains that walk along silhouettes (Xu et al. 2024); docs/baselines.md.

`estimator` is the term. `segments` has what a chain is in, and how much light that carries; `walks` the small step
along a silhouette, over the vertices of a mesh; `metropolis` the chains: how they start, step and are weighted.
"""

from jaxdr.boundary.baselines.markov_chains.estimator import MarkovChains as MarkovChains
