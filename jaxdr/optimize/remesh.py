"""Remeshing between phases of an optimisation."""

from collections.abc import Callable

import numpy as np

from jaxdr.geometry.edges import NON_MANIFOLD
from jaxdr.geometry.mesh import Mesh


def remesh(mesh: Mesh, edge_length: float, iterations: int = 10) -> Mesh:
    """A mesh of the same surface whose edges are all about `edge_length` long (scene units).

    Botsch and Kobbelt 2004, "A Remeshing Approach to Multiresolution Modeling", through gpytoolbox: `iterations`
    rounds of splitting, collapsing and flipping edges, smoothing and projecting back. Runs on the host. The
    number of vertices changes, so preconditioner and optimiser state start afresh. UVs are dropped; a mesh
    with interpolated normals gets one per vertex.

    Raises ImportError without gpytoolbox, and ValueError for an edge length that is not positive or longer than
    the mesh, for a non-manifold mesh, and when the result is empty, not finite, non-manifold or no longer closed.
    """
    remesh_botsch = require_gpytoolbox()
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    if not np.isfinite(vertices).all():
        raise ValueError("remesh: the mesh has vertices that are not finite")
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if not 0 < edge_length < diagonal:
        raise ValueError(
            f"remesh: edge_length must lie between 0 and the mesh's diagonal {diagonal:.4g}, got {edge_length}"
        )
    if (np.asarray(mesh.edges.kind) == NON_MANIFOLD).any():
        raise ValueError("remesh: the mesh has edges with more than two faces or inconsistent orientation")

    vertices, faces = remesh_botsch(vertices, faces, iterations, float(edge_length), True)
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise ValueError(f"remesh: nothing usable is left at edge length {edge_length}; the mesh may be too coarse")
    result = Mesh(vertices, faces)
    if (np.asarray(result.edges.kind) == NON_MANIFOLD).any() or (mesh.closed and not result.closed):
        raise ValueError(f"remesh: the result is not manifold at edge length {edge_length}; try another one")
    return result if mesh.normal_faces is None else result.smooth()


def require_gpytoolbox() -> Callable:
    """gpytoolbox's remeshing function. Raises ImportError that says how to install it."""
    try:
        from gpytoolbox import remesh_botsch
    except ImportError as missing:
        raise ImportError('remesh needs gpytoolbox, which is optional: pip install "jaxdr[remesh]"') from missing
    return remesh_botsch
