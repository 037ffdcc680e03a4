"""Warnings of derivatives that are biased by nature, not by noise: measured rules (docs/stability.md).

The rules of estimators are their own, see `boundary.shared.traits`. `jaxdr.plan` and `boundary="auto"` use the same.
They depend on structure only. So they work under `jit` and cost nothing.
"""

from collections.abc import Iterator
from typing import Any

import jax

from jaxdr.boundary.shared.traits import known_failure, traits
from jaxdr.callers_line import warn
from jaxdr.moving import Moving
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.normal_map import TurnedNormal
from jaxdr.scene.scene import Scene, unwrap


class EstimatorWarning(UserWarning):
    """A derivative is biased by nature on a scene; the message says why, and what to take instead."""


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
