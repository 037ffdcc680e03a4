"""Boundary estimators: derivatives where visibility changes. Each has a folder; begin with its `estimator.py`.

A term (`shared.term`) is prepared once. It draws points on boundaries and requests the radiance there. From the answers
it makes an image that is zero in value and right in derivative. All estimators use `shared/`. `film/` has the terms of
visibility changes that the camera sees directly; they go with every estimator. `named` finds estimators by name, also
those of other packages. Imports go one way: shared, film, kernel_density, line_sampling, guided_edges, by_kind,
all_silhouettes, warped_area, baselines. To add an estimator, add a folder and a line here.
"""

from collections.abc import Callable
from typing import Any

from jaxdr.boundary.all_silhouettes import AllSilhouettes
from jaxdr.boundary.baselines.markov_chains import MarkovChains
from jaxdr.boundary.baselines.quadric_sampling import QuadricSampling
from jaxdr.boundary.baselines.redner_was import RednerWAS
from jaxdr.boundary.baselines.walk_on_caps import WalkOnCaps
from jaxdr.boundary.by_kind import ByKind
from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.boundary.warped_area import WarpedArea

# By the names that configs and the command line use.
ESTIMATORS: dict[str, Callable[..., Any]] = {
    "AllSilhouettes": AllSilhouettes,
    "ByKind": ByKind,
    "GuidedEdges": GuidedEdges,
    "KernelDensity": KernelDensity,
    "LineSampling": LineSampling,
    "MarkovChains": MarkovChains,
    "QuadricSampling": QuadricSampling,
    "RednerWAS": RednerWAS,
    "WalkOnCaps": WalkOnCaps,
    "WarpedArea": WarpedArea,
    "none": lambda: None,  # interior term only
}
