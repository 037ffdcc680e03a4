"""Remeshing between phases of an optimisation."""

from collections.abc import Callable

import numpy as np

from jaxdr.argument_kinds import checked
from jaxdr.geometry.edges import INTERIOR, NON_MANIFOLD
from jaxdr.geometry.mesh import Mesh

# Lengths that `remesh_to` tries, and the share of the vertices with which it is content: the rest are split edges.
ATTEMPTS = 10
ENOUGH = 0.95


@checked
def remesh(mesh: Mesh, edge_length: float, iterations: int = 10) -> Mesh:
    """A mesh of the same surface whose edges are all about `edge_length` long (scene units).

    Botsch and Kobbelt 2004, "A Remeshing Approach to Multiresolution Modeling", through gpytoolbox: `iterations` rounds
    of splitting, collapsing and flipping edges, smoothing and projecting back. It runs on the host. The number of
    vertices changes, so start preconditioner and optimiser afresh. UVs are dropped. A mesh with interpolated normals
    gets one per vertex.

    Raises ImportError without gpytoolbox. Raises ValueError for an edge length that is not positive or longer than the
    mesh, for a non-manifold mesh, and when the result is empty, not finite, non-manifold or no longer closed.
    """
    remesh_botsch = require_gpytoolbox()
    if iterations < 0:
        raise ValueError(f"remesh: iterations must not be negative, got {iterations}")
    check_manifold(mesh, "remesh")
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if not 0 < edge_length < diagonal:
        raise ValueError(
            f"remesh: edge_length must lie between 0 and the mesh's diagonal {diagonal:.4g}, got {edge_length}"
        )
    vertices, faces = remesh_botsch(vertices, faces, iterations, float(edge_length), True)
    result = checked_result(mesh, vertices, faces, f"remesh: edge length {edge_length}")
    return result if mesh.normal_faces is None else result.smooth()


def check_manifold(mesh: Mesh, what: str) -> None:
    """Raises ValueError, which begins with `what`, for a mesh that is not finite or not manifold."""
    if not np.isfinite(np.asarray(mesh.vertices)).all():
        raise ValueError(f"{what}: the mesh has vertices that are not finite")
    if (np.asarray(mesh.edges.kind) == NON_MANIFOLD).any():
        raise ValueError(f"{what}: the mesh has edges with more than two faces or inconsistent orientation")


def checked_result(mesh: Mesh, vertices: np.ndarray, faces: np.ndarray, what: str) -> Mesh:
    """What became of `mesh`; ValueError, which begins with `what`, if it is empty, not finite, not manifold or open."""
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise ValueError(f"{what}: nothing usable is left; the mesh may be too coarse")
    result = Mesh(vertices, faces)
    if (np.asarray(result.edges.kind) == NON_MANIFOLD).any() or (mesh.closed and not result.closed):
        raise ValueError(f"{what}: the result is not manifold; try a finer mesh")
    return result


def remesh_to(mesh: Mesh, vertices: int, iterations: int = 10) -> Mesh:
    """A mesh of the same surface with exactly `vertices` vertices, whose edges are all about equally long.

    An edge length for `remesh` is looked for that leaves a few vertices too few. Then the longest edges are split in
    their middle. Closed meshes of the same genus and number of vertices have the same number of faces and edges, so JAX
    compiles nothing anew for them.

    Raises what `remesh` raises, and ValueError for fewer than 4 vertices, or where no edge length is found.
    """
    if vertices < 4:
        raise ValueError(f"remesh_to: needs at least 4 vertices, got {vertices}")
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    # Of equilateral triangles, two a vertex.
    length = np.sqrt(2 * area / (np.sqrt(3) * vertices))
    short, long, best, problem = 0.0, np.inf, None, None
    for _ in range(ATTEMPTS):
        try:
            result = remesh(mesh, length, iterations)
        except ValueError as refused:  # most often for this length alone: the next one splits and joins other edges
            problem, length = refused, 0.97 * length
            continue
        share = len(result.vertices) / vertices
        if share <= 1:
            long, best = length, max((b for b in (best, result) if b), key=lambda mesh: len(mesh.vertices))
        else:
            short = length
        if ENOUGH <= share <= 1:
            break
        length *= np.sqrt(share / ((1 + ENOUGH) / 2))
        if not short < length < long:  # the number of vertices jumps with the length
            length = np.sqrt(short * long)
    if best is None and problem is not None:
        raise problem
    if best is None or len(best.vertices) < vertices / 2:
        raise ValueError(f"remesh_to: found no edge length that leaves about {vertices} vertices")
    result = split_longest_edges(best, vertices)
    return result if mesh.normal_faces is None else result.smooth()


def split_longest_edges(mesh: Mesh, vertices: int) -> Mesh:
    """A mesh with so many `vertices`, flat-shaded: its longest edges are split in their middle; those of one face stay.

    Raises ValueError for a mesh that has more of them already, or no edge of two faces.
    """
    points, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    if len(points) > vertices:
        raise ValueError(f"split_longest_edges: the mesh has {len(points)} vertices, more than {vertices}")
    while len(points) < vertices:
        mesh = Mesh(points, faces)
        edges, sides = np.asarray(mesh.edges.vertices), np.asarray(mesh.edges.faces)
        inner = np.flatnonzero(np.asarray(mesh.edges.kind) == INTERIOR)
        if not len(inner):
            raise ValueError("split_longest_edges: the mesh has no edge of two faces")
        lengths = np.linalg.norm(np.diff(points[edges[inner]], axis=1)[:, 0], axis=1)
        taken, chosen = np.zeros(len(faces), bool), []
        # Of the longest ones those without a face in common; the others when the mesh is looked at again.
        for edge in inner[np.argsort(-lengths, kind="stable")][: vertices - len(points)]:
            if not taken[sides[edge]].any():
                taken[sides[edge]] = True
                chosen.append(edge)
        points, faces = _split(points, faces, edges[chosen], sides[chosen])
    return Mesh(points, faces)


def _split(points, faces, edges, sides) -> tuple[np.ndarray, np.ndarray]:
    """Every one of `edges` [n, 2] split in its middle, with the two faces at it, `sides` [n, 2]."""
    middles = len(points) + np.arange(len(edges))
    faces, more = faces.copy(), []
    for edge, middle, pair in zip(edges, middles, sides, strict=True):
        for face in pair:
            corners = faces[face].copy()
            more.append(np.where(corners == edge[0], middle, corners))
            faces[face] = np.where(corners == edge[1], middle, corners)
    return np.concatenate([points, points[edges].mean(1)]), np.concatenate([faces, more])


def require_gpytoolbox() -> Callable:
    """gpytoolbox's remeshing function. Raises ImportError that says how to install it."""
    try:
        from gpytoolbox import remesh_botsch
    except ImportError as missing:
        raise ImportError('remesh needs gpytoolbox, which is optional: pip install -e ".[remesh]"') from missing
    return remesh_botsch
