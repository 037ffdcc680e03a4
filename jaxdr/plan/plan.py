"""`jaxdr.plan`: looks at a scene, runs estimators on a small image, and chooses the best for its derivatives."""

import math
from collections.abc import Sequence
from typing import Any

import jax
from jax.core import Tracer
from jaxtyping import PRNGKeyArray

from jaxdr.argument_kinds import checked, shown
from jaxdr.boundary.shared.term import Term
from jaxdr.integrators import Integrator, PathTracer
from jaxdr.integrators.choice import settled
from jaxdr.plan.candidates import candidates, splits
from jaxdr.plan.depth import DepthChoice, choose_depth
from jaxdr.plan.directions import direction, moving_along
from jaxdr.plan.pilot import Choice, Measured, Pilot, choose
from jaxdr.plan.report import Plan
from jaxdr.plan.static_look import StaticLook, static_look
from jaxdr.scene.film import Film
from jaxdr.scene.scene import Scene
from jaxdr.whole_numbers import whole

PIXELS = 48 * 48  # most pixels of the pilots' film
DEPTH_TOLERANCE = 0.02
MEASURED: Any = "auto"  # the estimator is to be chosen
NOTHING = (
    "nothing was measured: all derivatives are the same in every call; is the picture dark (a lamp shines to the side "
    "that its normals point to), and does what moves change it?"
)


@checked
def plan(
    scene: Scene,
    params: Sequence[str] | None = None,
    budget: float = 1.0,
    *,
    key: PRNGKeyArray | None = None,
    integrator: Integrator | None = None,
    max_depth: int | None = None,
    boundary: Any = MEASURED,
    spp: int | None = None,
    depth_tolerance: float = DEPTH_TOLERANCE,
) -> Plan:
    """Choose integrator and samples for derivatives of a scene by `params`, and say why.

    - `params`: names of `scene.parameters()`, or motions such as `spot.translate.x`; None for all vertices.
    - `budget`: seconds that a derivative image may take.
    - `max_depth`, `boundary` (an estimator or None), `spp`, `integrator`: if one is given, it is not chosen but kept.
    - `depth_tolerance`: share of the light, and of its derivative, that longer paths may carry.

    It runs the estimators with few samples on an image of about 48 x 48 pixels or fewer. That takes some minutes,
    nearly all of them for compilation, and does not work under `jit`. Timings vary, so the choice between equally good
    estimators may vary too. To repeat a run, keep the plan (`Plan.to_dict`). Raises ValueError for bad arguments, and
    if no estimator can differentiate the scene.
    """
    _check(scene, budget, max_depth, spp, integrator, boundary)
    key_direction, key_depth, key_pilot = jax.random.split(jax.random.key(0) if key is None else key, 3)
    integrator = None if integrator is None else settled(integrator, scene)
    along = direction(scene, params, key_direction)
    moving = moving_along(scene, tuple(along.values))
    look = static_look(scene, moving)
    small, ratio = small_film(scene)
    lines, figures = look.lines(), {"params": list(along.values)}

    depth = None
    if integrator is not None:
        max_depth = integrator.max_depth
    elif max_depth is None:
        depth = choose_depth(small, along, depth_tolerance, key_depth)
        max_depth = depth.max_depth
    lines.append(depth.line() if depth else f"depth: {max_depth} segments, as asked for")

    tried, left_out = {}, {}
    if integrator is not None:
        tried = {"as asked for": integrator}
    elif _automatic(boundary):
        found = candidates(look, max_depth)
        tried = {name: PathTracer(max_depth, estimator) for name, estimator in found.tried.items()}
        left_out = found.left_out
    else:
        name = "interior term only" if boundary is None else type(boundary).__name__
        tried = {f"{name}, as asked for": PathTracer(max_depth, boundary)}
    lines += [f"not tried: {name} ({reason})" for name, reason in left_out.items()]

    def changes(best: Any, shares: dict[str, float]) -> dict[str, Any]:
        return splits(best, shares) if integrator is None else {}

    chosen = choose(tried, Pilot(small, along, moving, key_pilot), changes, budget, spp, ratio)
    figures |= _figures(look, depth, chosen)
    measured = [m.variance for found in chosen.rounds for m in found.values() if isinstance(m, Measured)]
    if measured and not any(measured):
        lines.append(NOTHING)
    return Plan(chosen.integrator, chosen.spp, tuple(lines + chosen.lines), figures)


def small_film(scene: Scene) -> tuple[Scene, float]:
    """(the scene with a film of fewer pixels for the same view, ratio of its old number of pixels to the new one)."""
    film = scene.camera.film
    _, _, width, height = film.window
    scale = math.sqrt(PIXELS / (width * height))
    if scale >= 1.0:
        return scene, 1.0
    size = [max(1, round(scale * n)) for n in (film.width, film.height)]
    crop = film.crop
    if crop is not None:
        corner = [min(int(scale * n), limit - 1) for n, limit in zip(crop[:2], size, strict=True)]
        sides = [max(1, min(round(scale * n), s - c)) for n, s, c in zip(crop[2:], size, corner, strict=True)]
        crop = (corner[0], corner[1], sides[0], sides[1])
    fewer = Film(size[0], size[1], film.filter, crop)

    def is_film(node) -> bool:
        return isinstance(node, Film)

    small = jax.tree.map(lambda node: fewer if is_film(node) else node, scene, is_leaf=is_film)
    _, _, columns, rows = fewer.window
    return small, width * height / (columns * rows)


def _automatic(boundary: Any) -> bool:
    return isinstance(boundary, str) and boundary == MEASURED


def _check(scene, budget, max_depth, spp, integrator, boundary) -> None:
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scene)):
        raise ValueError("plan: measures time, so it can't run under jit or grad; make the plan before")
    if not budget > 0:
        raise ValueError(f"plan: budget must be positive (seconds of a derivative image), got {budget}")
    for name, value in (("max_depth", max_depth), ("spp", spp)):
        if value is not None and not whole(value):
            raise ValueError(f"plan: {name} must be a positive whole number, got {value}")
    if not (
        boundary is None or _automatic(boundary) or (isinstance(boundary, Term) and not isinstance(boundary, type))
    ):
        raise ValueError(
            f"plan: boundary must be an estimator such as jaxdr.LineSampling(), or None, got {shown(boundary)}"
        )
    if integrator is not None and (max_depth is not None or not _automatic(boundary)):
        raise ValueError("plan: an integrator that is given has its own max_depth and boundary; leave those out")


def _figures(look: StaticLook, depth: DepthChoice | None, chosen: Choice) -> dict[str, Any]:
    """Everything that was measured, as tables for JSON."""
    static = {name: value for name, value in look._asdict().items() if name != "moving"}
    static["textures"] = list(look.textures)
    static["traits"] = look.traits._asdict()
    figures: dict[str, Any] = {"static": static, "moving": _plain(look.moving._asdict())}
    if depth is not None:
        shares = {"energy": depth.energy} | ({"gradient": depth.gradient} if depth.gradient is not None else {})
        figures["depth"] = {n: {"rest": s.rest.tolist(), "error": s.error.tolist()} for n, s in shares.items()}
    figures["chosen"] = chosen.name
    figures["rounds"] = [
        {n: m._asdict() | ({"work": m.work} if isinstance(m, Measured) else {}) for n, m in found.items()}
        for found in chosen.rounds
    ]
    return figures


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in table.items()}
