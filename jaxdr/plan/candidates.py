"""The estimators that are tried on a scene, and the reasons why others are not."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx

from jaxdr.boundary.baselines.redner_was import RednerWAS
from jaxdr.boundary.by_kind import ByKind
from jaxdr.boundary.guided_edges import GuidedEdges
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.line_sampling import LineSampling
from jaxdr.boundary.shared.traits import known_failure
from jaxdr.integrators import PathTracer
from jaxdr.integrators.base import edge_points_per_sample
from jaxdr.plan.static_look import StaticLook
from jaxdr.scene.bsdf import Diffuse

# Tried in this order; of two equal ones the first wins. A wider kernel finds more edges, each with less weight.
ESTIMATORS: dict[str, Any] = {
    "LineSampling": LineSampling(),
    "KernelDensity": KernelDensity(),
    "KernelDensity, radius 0.06": KernelDensity(radius=0.06),
    "GuidedEdges": GuidedEdges(),
}
# They are never tried. They can be asked for by name.
LEFT_OUT = {
    "AllSilhouettes": "unbiased and accurate, but its first sample takes long; ask for it by name",
    "WarpedArea": "up to 5 % short with few auxiliary points, and noisier than the others wherever it was measured",
    "QuadricSampling": "unbiased, and ten times noisier than LineSampling where it was measured",
    "MarkovChains": "unbiased, and there for comparison: neighbouring samples of a chain are alike",
    "WalkOnCaps": "unbiased for direct light, and there for comparison: it has noise wherever light is seen",
}
SPLIT = 4.0  # factor by which a try raises or lowers the samples of a term
DOMINANT, NEGLIGIBLE = 0.7, 0.05  # a try is worth it above the first share of the variance, and below the second


class Candidates(NamedTuple):
    """Boundary estimators to be tried, by name, and reasons for those that are not tried, by name."""

    tried: dict[str, Any]
    left_out: dict[str, str]


def candidates(look: StaticLook, max_depth: int) -> Candidates:
    """The estimators to try for the derivative of a path tracer of this depth."""
    if not look.moving.any or max_depth == 1:
        return Candidates({"KernelDensity": KernelDensity()}, {})  # no boundary term is in the program
    tried, left_out = dict(ESTIMATORS), dict(LEFT_OUT)
    if set(look.lobes) - {Diffuse.__name__}:
        tried["ByKind"] = ByKind()
    left_out["RednerWAS"] = known_failure(RednerWAS(), look.traits) or ""
    for name, made in list(tried.items()):
        reason = known_failure(made, look.traits)
        if reason is not None:
            del tried[name]
            left_out[type(made).__name__] = reason
    return Candidates(tried, left_out)


def splits(tracer: Any, shares: dict[str, float]) -> dict[str, Any]:
    """Tracers with more or fewer samples for some terms, by name of the change. `shares` are those of the variance.

    It is empty if no term is out of proportion. `edge_samples` counts the samples of edges in the image, and
    `LineSampling.chords` or `GuidedEdges.samples` those of boundary segments. The interior term has as many as there
    are samples per pixel.
    """
    if not isinstance(tracer, PathTracer):
        return {}
    in_image = shares.get("silhouettes", 0.0) + shares.get("creases", 0.0)
    changed, changes = tracer, []
    if in_image > DOMINANT or ("silhouettes" in shares and in_image < NEGLIGIBLE):
        points = edge_points_per_sample(tracer) * (SPLIT if in_image > DOMINANT else 1 / SPLIT)
        changed = replaced(changed, edge_samples=points)
        changes.append(f"edge_samples={points:g}")
    field = {LineSampling: "chords", GuidedEdges: "samples"}.get(type(tracer.boundary))
    if field is not None and shares.get("boundary", 0.0) > DOMINANT:
        count = getattr(tracer.boundary, field) * SPLIT
        changed = replaced(changed, boundary=replaced(tracer.boundary, **{field: count}))
        changes.append(f"{field}={count:g}")
    return {", ".join(changes): changed} if changes else {}


def replaced(module: Any, **fields: Any) -> Any:
    """A module with some of its fields changed."""
    assert isinstance(module, eqx.Module)
    return dataclasses.replace(module, **fields)  # pyright: ignore[reportArgumentType]
