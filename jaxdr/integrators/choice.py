"""`boundary="auto"`: the boundary estimator is chosen by the structure of a scene, when a program is traced.

The choice depends on kinds of models and numbers of edges, never on values. So it is the same with and without `jit`,
and costs nothing. `RULES` has all of it, in order.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx

from jaxdr.boundary.by_kind import ByKind
from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.boundary.shared.traits import known_failure, traits
from jaxdr.boundary.warped_area import WarpedArea
from jaxdr.scene.bsdf.base import has_lobe, spreads_through
from jaxdr.scene.camera import Perspective
from jaxdr.scene.scene import Scene, unwrap

# Guided edges look for silhouettes among all edges. In finer meshes too few edges are silhouettes.
FEW_EDGES = 60_000


class Automatic(eqx.Module):
    """The boundary estimator of an integrator that is not chosen yet: `boundary="auto"`."""


def automatic(boundary: Any) -> Any:
    """An integrator's `boundary`, in which "auto" is `Automatic`."""
    return Automatic() if isinstance(boundary, str) and boundary == "auto" else boundary


class Rule(NamedTuple):
    """An estimator, the scenes that it is for, and why. `holds` decides by the scene and `PathTracer.primary`."""

    scenes: str
    estimator: Any
    why: str
    holds: Callable[[Scene, str], bool]


class Choice(NamedTuple):
    """A boundary estimator, and a sentence that says why it is taken."""

    estimator: Any
    reason: str


def _few_and_flat(scene: Scene, primary: str) -> bool:
    """Whether `GuidedEdges` covers the scene, and enough of the edges are silhouettes."""
    shapes = scene.shapes.values()
    models = [unwrap(shape.bsdf) for shape in shapes]
    covered = not any(model.delta or model.inside or spreads_through(model) for model in models)
    flat = all(shape.mesh.normal_faces is None for shape in shapes)
    edges = sum(shape.mesh.edges.vertices.shape[0] for shape in shapes)
    return covered and flat and isinstance(scene.camera, Perspective) and edges <= FEW_EDGES


def _diffuse(scene: Scene, primary: str) -> bool:
    """The same, and no surface is glossy."""
    return _few_and_flat(scene, primary) and not any(has_lobe(unwrap(s.bsdf)) for s in scene.shapes.values())


# The first rule that holds decides. They come from experiments/default_choice and docs/by_difficulty.md.
RULES = (
    Rule(
        '`primary="warp"`',
        WarpedArea(),
        "no other estimator has this form of first hits",
        lambda scene, primary: primary == "warp",
    ),
    Rule(
        f"flat, diffuse surfaces of up to {FEW_EDGES:,} edges, seen by a `Perspective`",
        GuidedEdges(),
        "its segments begin at edges, so contacts and lamps of any kind make little noise",
        _diffuse,
    ),
    Rule(
        "the same, with glossy surfaces; but no mirrors, glass, masks, blends or maps of normals",
        ByKind(),
        "`GuidedEdges`, and `LineSampling` for what glossy lobes reflect, which is seldom found from edges",
        _few_and_flat,
    ),
    Rule(
        "all others",
        LineSampling(),
        "its noise hardly grows with the number of edges, and it follows lobes of any width",
        lambda scene, primary: True,
    ),
)


def choose(scene: Scene, primary: str = "fixed_ray") -> Choice:
    """The estimator of the first rule that holds and that does not fail on the scene by nature, with the reason."""
    found = traits(scene)
    # The last rule holds for every scene, and its estimator fails on none.
    rule = next(r for r in RULES if r.holds(scene, primary) and known_failure(r.estimator, found) is None)
    return Choice(rule.estimator, f"{type(rule.estimator).__name__}, for {rule.scenes}: {rule.why}")


def settled(integrator: Any, scene: Scene) -> Any:
    """The integrator with its boundary estimator, which is chosen here if it is `Automatic`.

    A `BidirectionalPathTracer` takes `KernelDensity`, the least noisy of those that connect subpaths.
    """
    if not isinstance(getattr(integrator, "boundary", None), Automatic):
        return integrator
    primary = getattr(integrator, "primary", None)
    estimator = KernelDensity() if primary is None else choose(scene, primary).estimator
    return dataclasses.replace(integrator, boundary=estimator)


def table() -> str:
    """The rules as a table in Markdown."""
    rows = [f"| {rule.scenes} | `{type(rule.estimator).__name__}` | {rule.why} |" for rule in RULES]
    return "\n".join(["| scenes | estimator | why |", "| --- | --- | --- |", *rows]) + "\n"
