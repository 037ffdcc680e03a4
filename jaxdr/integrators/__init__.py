"""Integrators: how `render` estimates images, as static settings. To add one, add a file and a line here."""

from jaxdr.integrators.base import ConnectedEstimator as ConnectedEstimator
from jaxdr.integrators.base import Integrator as Integrator
from jaxdr.integrators.bidirectional import BidirectionalPathTracer as BidirectionalPathTracer
from jaxdr.integrators.path_tracer import PathTracer as PathTracer

# By the names that configs and the command line use. Plans use the names of the classes.
INTEGRATORS: dict[str, type[PathTracer] | type[BidirectionalPathTracer]] = {
    "path": PathTracer,
    "bdpt": BidirectionalPathTracer,
}
