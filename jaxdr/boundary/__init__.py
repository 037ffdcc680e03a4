"""Boundary estimators: derivatives of what is seen, where visibility changes. Adding one: a file, and a line here."""

from collections.abc import Callable
from typing import Any

from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.boundary.redner_was import RednerWAS
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
