"""What to estimate with where nobody says it: known from the structure of a scene, before any ray."""

from typing import Any

from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.callers_line import warn
from jaxdr.integrators.known_failures import known_failure, traits
from jaxdr.integrators.path_tracer import PathTracer
from jaxdr.moving import Moving
from jaxdr.scene.scene import Scene


class EstimatorChoice(UserWarning):
    """A default estimator would fail on a scene, and another one was taken; the message names both and the reason."""


def default_integrator(scene: Scene, moving: Moving | None = None, max_depth: int = 3) -> PathTracer:
    """The path tracer that `render` takes: `KernelDensity`, but `LineSampling` where a kernel fails.

    It looks at structure alone: the numbers of faces, the kinds of emitters, and what is differentiated, if `moving`
    says so. So the choice is the same with and without `jit`, and costs nothing.
    """
    usual = PathTracer(max_depth)
    return PathTracer(max_depth, LineSampling()) if _why_not(usual.boundary, scene, moving) else usual


def default_reason(scene: Scene, moving: Moving | None = None) -> str | None:
    """One sentence of what `default_integrator` took in place of what it usually takes; None where it did not."""
    usual, taken = PathTracer().boundary, default_integrator(scene, moving).boundary
    reason = _why_not(usual, scene, moving)
    if reason is None:
        return None
    return f"{type(taken).__name__} is taken in place of {type(usual).__name__}: {reason}"


def say_default(scene: Scene, moving: Moving) -> None:
    """An `EstimatorChoice` at the caller's line, which Python shows once a line and text. Called while tracing."""
    reason = default_reason(scene, moving)
    if reason is not None:
        warn(f"jaxdr: no integrator was given; {reason}", EstimatorChoice)


def _why_not(boundary: Any, scene: Scene, moving: Moving | None) -> str | None:
    """Why `KernelDensity` is not taken; None where it is."""
    failure = known_failure(boundary, traits(scene))
    if failure is not None:
        return failure.rpartition("; take ")[0]
    sky = scene.environment
    if sky is not None and not sky.uniform and moving is not None and moving.environment:
        return "it has six times the noise where a sky turns"
    return None
