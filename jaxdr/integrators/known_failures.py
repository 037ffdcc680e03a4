"""Where derivatives are biased by nature, not by noise: measured rules (docs/stability.md), and warnings.

`jaxdr.plan` and `render` without an integrator use the same rules. They depend on structure only, such as the sizes of
arrays. So they work under `jit` and cost nothing.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax

from jaxdr.boundary.baselines.markov_chains import MarkovChains
from jaxdr.boundary.baselines.redner_was import RednerWAS
from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.warped_area import WarpedArea
from jaxdr.callers_line import warn
from jaxdr.moving import Moving
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.normal_map import TurnedNormal
from jaxdr.scene.emitter_clusters import FEW_FACES
from jaxdr.scene.scene import Scene, unwrap

# With so many faces in one mesh, or more, kernel density is clearly too large (experiments/tessellation). Guided edges
# were measured at a million faces only (docs/stability.md).
FINE = 300_000
# With fewer auxiliary points a clear part of a boundary's velocity is missing (experiments/warped_area).
ENOUGH_POINTS = 6


class EstimatorWarning(UserWarning):
    """A derivative is biased by nature on a scene; the message says why, and what to take instead."""


class Traits(NamedTuple):
    """Properties of a scene that make estimators fail.

    - `fine`: name of the shape with the most faces, if it has `FINE` or more; else None.
    - `emitter_faces`: number of faces of area emitters.
    """

    fine: str | None
    emitter_faces: int


def traits(scene: Scene) -> Traits:
    """The `Traits` of a scene, traced or not."""
    faces = {name: shape.mesh.faces.shape[0] for name, shape in scene.shapes.items()}
    largest = max(faces, key=lambda name: faces[name])
    emitting = (faces[name] for name, shape in scene.shapes.items() if shape.emitter is not None)
    return Traits(largest if faces[largest] >= FINE else None, sum(emitting))


def known_failure(boundary: Any, found: Traits) -> str | None:
    """Why a boundary estimator is biased on such a scene, with any number of samples, and the remedy; None if not."""
    if isinstance(boundary, KernelDensity | GuidedEdges | MarkovChains) and found.fine is not None:
        return (
            f"it is too large by 6 % or more on meshes of {FINE:,} faces or more, such as {found.fine}: silhouettes "
            "that are hidden by no more than rounding count as visible; take LineSampling"
        )
    if isinstance(boundary, KernelDensity) and found.emitter_faces > FEW_FACES:
        return (
            f"it is too small under area emitters of more than {FEW_FACES} faces if the faces are smaller than its "
            "kernel (by 5 % under a tiny lamp); take LineSampling"
        )
    if isinstance(boundary, WarpedArea | RednerWAS) and boundary.distance == "exponential":
        return (
            'with distance="exponential" (Eq. 57) half of a derivative or more is missing, because its velocity does '
            'not reach that of the boundary; take distance="path_space", or LineSampling'
        )
    if isinstance(boundary, WarpedArea) and boundary.samples < ENOUGH_POINTS:
        return (
            f"with {boundary.samples} auxiliary points 5 to 30 % of a derivative are missing; take samples=16, or "
            "LineSampling"
        )
    if isinstance(boundary, RednerWAS) and not boundary.normal_edges:
        return (
            "with normal_edges=False the motion of silhouettes between two faces is missing; take normal_edges=True, "
            "or LineSampling"
        )
    if isinstance(boundary, RednerWAS):
        return (
            "up to half of a derivative is missing under small lights and behind narrow blockers (docs/stability.md); "
            "take LineSampling"
        )
    return None


def warn_of_known_failure(scene: Scene, boundary: Any) -> None:
    """Warn with an `EstimatorWarning` at the caller's line. Python shows it once for each line and text.

    Called while tracing.
    """
    reason = known_failure(boundary, traits(scene))
    if reason is not None:
        warn(f"jaxdr: {type(boundary).__name__} fails by nature here: {reason}", EstimatorWarning)


def turning_away(active: Scene, moving: Moving, max_depth: int) -> str | None:
    """Name of a shape where the jump of turned normals may move; None if there is none.

    A normal or bump map flips the normals that face away from the previous vertex of a path. The image jumps there, and
    the curve of the jump has no term. It moves with the surface, with the map, and with the previous vertex: the camera
    or, in indirect light, a point of any shape. The leaves of `active` say which floats are differentiated.
    """
    if max_depth < 2:
        return None
    apex_moves = moving.camera or (max_depth > 2 and any(moving.shapes))
    for name, flags in active.shapes.items():
        for turned in _turned_normals(unwrap(flags.bsdf)):
            # All leaves but those of the BSDF inside turn the normal.
            turns = sum(jax.tree.leaves(turned)) > sum(jax.tree.leaves(turned.bsdf))
            if apex_moves or turns or any(jax.tree.leaves(flags.mesh)):
                return name
    return None


def _turned_normals(bsdf: BSDF) -> Iterator[TurnedNormal]:
    """The normal and bump maps in a BSDF."""
    if isinstance(bsdf, TurnedNormal):
        yield bsdf
    for inside in bsdf.inside:
        yield from _turned_normals(inside)


def warn_of_cuts() -> None:
    """Warn with an `EstimatorWarning` at the caller's line that warped camera rays know no clipping planes."""
    warn(
        'jaxdr: with primary="warp" the derivative lacks the motion of lines at which near_clip or far_clip cuts a '
        'surface. It is right where they cut none; else take primary="fixed_ray"',
        EstimatorWarning,
    )


def warn_of_turning_away(active: Scene, moving: Moving, max_depth: int) -> None:
    """Warn with an `EstimatorWarning` at the caller's line where `turning_away` finds a shape."""
    name = turning_away(active, moving, max_depth)
    if name is not None:
        warn(
            f"jaxdr: the derivative lacks a jump inside the faces of {name}: its normal or bump map flips normals that "
            "face away from the viewer. It is right where none does, but may be off by more than its own size where "
            "bumps are steep and seen at a slant; take flatter maps, a steeper view, or big bumps as part of the mesh",
            EstimatorWarning,
        )
