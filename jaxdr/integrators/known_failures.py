"""Where boundary estimators fail by nature, not by noise: rules that were measured (docs/stability.md), and a warning.

`jaxdr.plan` and `render` without an integrator go by the same rules. They look at structure alone, the sizes of
arrays, so that they hold under `jit` and cost nothing.
"""

from typing import Any, NamedTuple

from jaxdr.boundary.baselines.redner_was import RednerWAS
from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.warped_area import WarpedArea
from jaxdr.callers_line import warn
from jaxdr.scene.emitter_clusters import FEW_FACES
from jaxdr.scene.scene import Scene

# Faces of one mesh from which on kernel density is too large by 6 per cent and more (experiments/tessellation). Guided
# edges were measured at a million alone: by 7 ± 3 per cent (docs/stability.md).
FINE = 300_000
# Auxiliary points below which 5 per cent of a boundary's velocity and more are not found (experiments/warped_area).
ENOUGH_POINTS = 6


class EstimatorWarning(UserWarning):
    """A boundary estimator is biased by nature on what a scene has; the message says why and what to take instead."""


class Traits(NamedTuple):
    """What of a scene makes estimators fail.

    - `fine`: the shape of most faces, where it has `FINE` or more; or None.
    - `emitter_faces`: of area emitters.
    """

    fine: str | None
    emitter_faces: int


def traits(scene: Scene) -> Traits:
    """From the structure of a scene, traced or not."""
    faces = {name: shape.mesh.faces.shape[0] for name, shape in scene.shapes.items()}
    largest = max(faces, key=lambda name: faces[name])
    emitting = (faces[name] for name, shape in scene.shapes.items() if shape.emitter is not None)
    return Traits(largest if faces[largest] >= FINE else None, sum(emitting))


def known_failure(boundary: Any, found: Traits) -> str | None:
    """Why a boundary estimator is biased on such a scene whatever its samples, and the remedy; None where it is not."""
    if isinstance(boundary, KernelDensity | GuidedEdges) and found.fine is not None:
        return (
            f"it is 6 % too large and more on meshes of {FINE:,} faces, as {found.fine} has: silhouettes that are "
            "hidden within rounding count; take LineSampling"
        )
    if isinstance(boundary, KernelDensity) and found.emitter_faces > FEW_FACES:
        return (
            f"it is too small under area emitters of more than {FEW_FACES} faces where those are smaller than its "
            "kernel (by 5 % under a tiny lamp); take LineSampling"
        )
    if isinstance(boundary, WarpedArea | RednerWAS) and boundary.distance == "exponential":
        return (
            'with distance="exponential" (Eq. 57) half of a derivative and more is missing: its velocity does not '
            'reach the boundary\'s; take distance="path_space", or LineSampling'
        )
    if isinstance(boundary, WarpedArea) and boundary.samples < ENOUGH_POINTS:
        return (
            f"with {boundary.samples} auxiliary points 5 to 30 % of a derivative are missing; take samples=16, or "
            "LineSampling"
        )
    if isinstance(boundary, RednerWAS) and not boundary.normal_edges:
        return (
            "with normal_edges=False silhouettes between two faces of a solid don't move; take normal_edges=True, or "
            "LineSampling"
        )
    if isinstance(boundary, RednerWAS):
        return (
            "up to half of a derivative is missing under small lights and behind narrow blockers (docs/stability.md); "
            "take LineSampling"
        )
    return None


def warn_of_known_failure(scene: Scene, boundary: Any) -> None:
    """An `EstimatorWarning` at the caller's line, which Python shows once a line and text. Called while tracing."""
    reason = known_failure(boundary, traits(scene))
    if reason is not None:
        warn(f"jaxdr: {type(boundary).__name__} fails by nature here: {reason}", EstimatorWarning)
