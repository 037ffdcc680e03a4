"""Space carving: what lies before points that cameras saw is empty (Kutulakos and Seitz 2000, by rays of points)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.queries import Geometry, Rays, closest_hit
from jaxdr.optimize.reconstruction.hull import surface_of

DEEP = 0.03  # of the longest side: beyond what points are off by
HOLLOW = 0.15  # share of the points from which on the outlines alone are no good start
CELLS = 96  # along the longest side
BEFORE = 1.5  # cells: points are about right to so much, so that rays end so far before them
RAYS = 3  # through a cell that is empty, at least: a wrong point alone empties nothing
BAND = 3  # cells: distances are exact so near to the surface
AT_ONCE = 1 << 14  # rays


def hollow(mesh: Mesh, origin: Float[np.ndarray, "N 3"], point: Float[np.ndarray, "N 3"]) -> float:
    """Share of the rays from cameras to points they saw, on which a surface is well before the point."""
    if not len(point):
        return 0.0
    rays = Rays(*(jnp.asarray(a, jnp.float32) for a in (origin, point - origin, np.full(len(point), 1.0))))
    hit = closest_hit(Geometry(mesh.vertices, mesh.faces), rays)
    before = (1 - np.asarray(hit.t)) * np.linalg.norm(point - origin, axis=1)
    return float(((np.asarray(hit.face) >= 0) & (before > DEEP)).mean())


def carved(
    mesh: Mesh, origin: Float[np.ndarray, "N 3"], point: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "V 3"], np.ndarray]:
    """(vertices, faces) of a closed surface without what rays from cameras to points they saw pass through.

    Raises ValueError where nothing is left.
    """
    from gpytoolbox import fast_winding_number
    from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

    from jaxdr.optimize.warp_distances import surface_distances  # on use: importing Warp takes long

    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    low, high = vertices.min(0), vertices.max(0)
    cell = float((high - low).max()) / CELLS
    low = low - 2 * cell
    counts = np.ceil((high + 2 * cell - low) / cell).astype(int)
    axes = [low[i] + cell * np.arange(counts[i]) for i in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    inside = (fast_winding_number(nodes, vertices, faces) > 0.5).reshape(counts)
    values = cell * BAND * np.where(inside, 1.0, -1.0)
    near = binary_dilation(inside, iterations=BAND) != binary_erosion(inside, iterations=BAND)
    some = nodes[near.ravel()].astype(np.float32)
    distance = np.minimum(surface_distances(some, vertices.astype(np.float32), faces), cell * BAND)
    values[near] = np.where(inside[near], distance, -distance)
    empty = _passed(origin, point, low, cell, counts) >= RAYS
    # The border of what is empty, smooth over a cell, as a distance.
    border = 2 * cell * (0.5 - gaussian_filter(empty.astype(float), 1.0))
    least = np.where(border < 0.5 * cell, np.minimum(values, border), values)
    if not (least > 0).any():
        raise ValueError("nothing of the first surface is left in front of the points that photographs saw")
    return surface_of(least, low, np.full(3, cell))


def _passed(origin, point, low, cell, counts):
    """How many rays pass each cell, up to a little before their points."""
    total = np.zeros(int(np.prod(counts)), int)
    middle = low + 0.5 * cell * counts
    half = 0.5 * float(np.linalg.norm(counts))
    steps = cell * np.arange(-half, half)  # from where a ray is nearest to the middle
    for start in range(0, len(point), AT_ONCE):
        begin = origin[start : start + AT_ONCE]
        towards = point[start : start + AT_ONCE] - begin
        far = np.linalg.norm(towards, axis=1, keepdims=True)
        towards /= far
        along = ((middle - begin) * towards).sum(1, keepdims=True) + steps
        index = np.round((begin[:, None] + along[..., None] * towards[:, None] - low) / cell).astype(int)
        passed = (along > 0) & (along < far - BEFORE * cell)
        within = passed & ((index >= 0) & (index < counts)).all(-1)
        total += np.bincount(np.ravel_multi_index(tuple(index[within].T), tuple(counts)), minlength=len(total))
    return total.reshape(counts)
