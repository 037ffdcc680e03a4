"""Whether a mesh has folded over itself on its way: what an optimisation without enough smoothing ends in."""

import numpy as np

from jaxdr.geometry.edges import INTERIOR
from jaxdr.geometry.mesh import Mesh

STEEP = -0.5  # cosine between normals of neighbouring faces: they turn by more than 120 degrees
COLLAPSED = 0.02  # share of folded edges, beyond that of the initial mesh, from which on a run says so


def folded_share(mesh: Mesh) -> float:
    """Share of the interior edges at which the surface turns by more than 120 degrees.

    Faces without area count as folded; 0 for a mesh without interior edges.
    """
    points, edges = np.asarray(mesh.vertices, np.float64), mesh.edges
    inside = np.asarray(edges.kind) == INTERIOR
    if not inside.any():
        return 0.0
    start, end = points[np.asarray(edges.vertices)[inside]].transpose(1, 0, 2)
    one, two = points[np.asarray(edges.opposite)[inside, :2]].transpose(1, 0, 2)
    left, right = np.cross(end - start, one - start), np.cross(two - start, end - start)
    size = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=1)
    return float(np.mean((left * right).sum(1) <= STEEP * size))


def collapse_message(iteration: int, share: float) -> str:
    """The words with which a run says that its mesh has folded."""
    return (
        f"after step {iteration}: the surface is folded over at {share:.0%} of its edges: the mesh is collapsing; "
        "raise optimizer.lam, lower optimizer.learning_rate, or remesh"
    )
