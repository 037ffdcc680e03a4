"""Derivatives of what is seen, where visibility changes: boundary estimators, one folder each; begin with `estimator`.

A term (`shared.term`) is prepared once, draws points on boundaries and asks for the radiance there, and says what the
answers are worth: an image, zero in value and right in derivative. All stand on `shared/`; `film/` has the terms of
what the camera sees itself, which go with every estimator. `named` finds estimators by name, those of others as well.
Imports go one way: shared, film, kernel_density, line_sampling, guided_edges, warped_area, baselines.
Adding an estimator: a folder, and a line here.
"""

from collections.abc import Callable
from typing import Any

from jaxdr.boundary.baselines.redner_was import RednerWAS
from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.boundary.warped_area import WarpedArea

# By the names that configs and the command line use.
ESTIMATORS: dict[str, Callable[..., Any]] = {
    "GuidedEdges": GuidedEdges,
    "KernelDensity": KernelDensity,
    "LineSampling": LineSampling,
    "RednerWAS": RednerWAS,
    "WarpedArea": WarpedArea,
    "none": lambda: None,  # interior term only
}
