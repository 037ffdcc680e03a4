"""The default integrator, chosen by the structure of a scene before any ray is traced."""

from typing import Any

from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.callers_line import warn
from jaxdr.integrators.known_failures import known_failure, traits
from jaxdr.integrators.path_tracer import PathTracer
from jaxdr.moving import Moving
from jaxdr.scene.bsdf import Diffuse
from jaxdr.scene.camera import Perspective
from jaxdr.scene.scene import Scene, unwrap


class EstimatorChoice(UserWarning):
    """The default estimator would fail on a scene, so another one was taken; the message names both and the reason."""


def default_integrator(scene: Scene, moving: Moving | None = None, max_depth: int = 3) -> PathTracer:
    """The path tracer that `render` takes: with `KernelDensity` or, where that fails, with another estimator.

    The other estimator is `LineSampling` or, under lamps that are meshes, `GuidedEdges`. The latter needs diffuse and
    flat surfaces, a `Perspective` camera, and no environment. The choice depends on structure only: the numbers of
    faces, the kinds of emitters and, with `moving`, what is differentiated. So it is the same with and without `jit`,
    and costs nothing.
    """
    usual = PathTracer(max_depth)
    if _why_not(usual.boundary, scene, moving) is None:
        return usual
    guided = GuidedEdges()
    better = _all_diffuse(scene) and known_failure(guided, traits(scene)) is None
    return PathTracer(max_depth, guided if better else LineSampling())


def default_reason(scene: Scene, moving: Moving | None = None) -> str | None:
    """A sentence about the estimator that `default_integrator` took in place of the usual one; None if it did not."""
    usual, taken = PathTracer().boundary, default_integrator(scene, moving).boundary
    reason = _why_not(usual, scene, moving)
    if reason is None:
        return None
    return f"{type(taken).__name__} is taken in place of {type(usual).__name__}: {reason}"


def say_default(scene: Scene, moving: Moving) -> None:
    """Warn with an `EstimatorChoice` at the caller's line. Python shows it once for each line and text.

    Called while tracing.
    """
    reason = default_reason(scene, moving)
    if reason is not None:
        warn(f"jaxdr: no integrator was given; {reason}", EstimatorChoice)


def _all_diffuse(scene: Scene) -> bool:
    """Whether `GuidedEdges` covers the scene and has less noise than `LineSampling` (experiments/mesh_lamps).

    It does not cover interpolated normals and other cameras, and is noisy where rough mirrors show an object.
    """
    shapes = scene.shapes.values()
    diffuse = all(isinstance(unwrap(shape.bsdf), Diffuse) and shape.mesh.normal_faces is None for shape in shapes)
    return diffuse and isinstance(scene.camera, Perspective) and scene.environment is None


def _why_not(boundary: Any, scene: Scene, moving: Moving | None) -> str | None:
    """Why `boundary`, the usual `KernelDensity`, is not taken; None if it is."""
    failure = known_failure(boundary, traits(scene))
    if failure is not None:
        return failure.rpartition("; take ")[0]
    sky = scene.environment
    if sky is not None and not sky.uniform and moving is not None and moving.environment:
        return "it has six times the noise where a sky turns"
    return None
