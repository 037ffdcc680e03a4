"""What to estimate with where nobody says it: known from the structure of a scene, before any ray."""

from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.integrators.path_tracer import PathTracer
from jaxdr.scene.scene import Scene

# Faces of one mesh from which on kernel density is too large by 6 per cent and more (experiments/tessellation).
FINE = 300_000


def fine_mesh(scene: Scene) -> str | None:
    """The shape with the most faces, if it is too fine for a kernel."""
    name = max(scene.shapes, key=lambda name: scene.shapes[name].mesh.faces.shape[0])
    return name if scene.shapes[name].mesh.faces.shape[0] >= FINE else None


def default_integrator(scene: Scene) -> PathTracer:
    """The path tracer that `render` takes: `KernelDensity`, but `LineSampling` where a mesh is too fine for it."""
    return PathTracer(boundary=LineSampling()) if fine_mesh(scene) else PathTracer()
