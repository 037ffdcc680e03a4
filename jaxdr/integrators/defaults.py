"""What to estimate with where nobody says it: known from the structure of a scene, before any ray."""

from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.integrators.known_failures import known_failure, traits
from jaxdr.integrators.path_tracer import PathTracer
from jaxdr.scene.scene import Scene


def default_integrator(scene: Scene) -> PathTracer:
    """The path tracer that `render` takes: `KernelDensity`, but `LineSampling` where a kernel fails by nature."""
    chosen = PathTracer()
    return PathTracer(boundary=LineSampling()) if known_failure(chosen.boundary, traits(scene)) else chosen
