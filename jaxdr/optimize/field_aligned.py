"""Remeshing along a field of directions, so that edges go on straight in long chains."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from jaxdr.argument_kinds import checked
from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.remesh import check_manifold, checked_result, split_longest_edges

LEAST = 16  # vertices
ATTEMPTS = 8
ENOUGH = 0.985  # share of the vertices with which it is content: the rest are split edges, where chains end
FEWER = 0.97  # of the vertices asked for, after a result with holes

# In a process of its own: Instant Meshes writes its progress to the standard output, whoever that belongs to.
SCRIPT = """
import sys, numpy, pyinstantmeshes
given = numpy.load(sys.argv[1])
vertices, faces = pyinstantmeshes.remesh(
    given["vertices"], given["faces"], target_vertex_count=int(given["count"]), rosy=6, posy=3,
    align_to_boundaries=bool(given["open"]), deterministic=True,
)
numpy.savez(sys.argv[2], vertices=vertices, faces=faces)
"""


@checked
def remesh_field_aligned(mesh: Mesh, vertices: int) -> Mesh:
    """A mesh of the same surface with exactly `vertices` vertices, whose edges form long straight chains.

    Jakob et al. 2015, "Instant Field-Aligned Meshes", through pyinstantmeshes: triangles along a smooth field of six
    directions. Then the longest edges are split until the number is met (one or two in a hundred). Such meshes suit the
    sorted edges of `GuidedEdges` (Yan et al. 2022, 4.3). It runs on the host; the same mesh and number give the same
    result. UVs are dropped. A mesh with interpolated normals gets one per vertex.

    Raises ImportError without pyinstantmeshes. Raises ValueError for fewer than 16 vertices, for a mesh that is not
    finite or not manifold, and where no result is manifold (and closed, if the mesh is).
    """
    require_pyinstantmeshes()
    if vertices < LEAST:
        raise ValueError(f"remesh_field_aligned: needs at least {LEAST} vertices, got {vertices}")
    check_manifold(mesh, "remesh_field_aligned")
    points = np.asarray(mesh.vertices, np.float64)
    centre, size = (points.max(0) + points.min(0)) / 2, float(np.ptp(points, axis=0).max())
    target, best, problem = vertices * (1 + ENOUGH) / 2, None, None
    for _ in range(ATTEMPTS):
        found, faces = _instant_mesh((points - centre) / size, np.asarray(mesh.faces), round(target), not mesh.closed)
        share = len(found) / vertices
        try:
            result = checked_result(
                mesh, found * size + centre, faces, f"remesh_field_aligned: about {vertices} vertices"
            )
        except ValueError as holes:
            problem = holes
            target *= FEWER
            continue
        if share <= 1:
            best = max((b for b in (best, result) if b is not None), key=lambda mesh: len(mesh.vertices))
        if ENOUGH <= share <= 1:
            break
        target *= (1 + ENOUGH) / 2 / share
    if best is None or len(best.vertices) < vertices / 2:
        raise problem or ValueError(
            f"remesh_field_aligned: found no mesh of about {vertices} vertices; try another number"
        )
    result = split_longest_edges(best, vertices)
    return result if mesh.normal_faces is None else result.smooth()


def _instant_mesh(
    points: np.ndarray, faces: np.ndarray, count: int, with_border: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, faces) of about `count` vertices, those that no face has left out."""
    with tempfile.TemporaryDirectory(prefix="jaxdr_") as folder:
        given, answer = Path(folder, "given.npz"), Path(folder, "answer.npz")
        np.savez(given, vertices=points.astype(np.float32), faces=faces.astype(np.int32), count=count, open=with_border)
        command = [sys.executable, "-c", SCRIPT, str(given), str(answer)]
        # In a session of its own: Ctrl-C is for the run that waits for it.
        done = subprocess.run(command, capture_output=True, text=True, start_new_session=True)
        if done.returncode != 0 or not answer.exists():
            last = (done.stderr.strip() or done.stdout.strip() or "no output").splitlines()[-1]
            raise ValueError(f"remesh_field_aligned: Instant Meshes failed on this mesh ({last})")
        with np.load(answer) as arrays:
            vertices, faces = arrays["vertices"].astype(np.float64), arrays["faces"].astype(np.int32)
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def require_pyinstantmeshes() -> None:
    """Raises ImportError that says how to install it."""
    try:
        import pyinstantmeshes  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as missing:
        raise ImportError(
            'remesh_field_aligned needs pyinstantmeshes, which is optional: pip install -e ".[field-aligned]"'
        ) from missing
