"""Colours of a surface as photographs show them: where the albedo starts."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.pictures import Cut

LIFT = 1e-3  # of the longest side: visibility is asked for from so far above the surface
GREY = 0.3  # mean albedo to start with, a common one; the light takes the rest
DARKEST, BRIGHTEST = 0.03, 0.9  # albedo to start with


def first_albedo(mesh: Mesh, photographs: Sequence[Cut]) -> Float[np.ndarray, "V 3"]:
    """Mean colour of every vertex over the photographs that see it, by the cosine at which they do, scaled to a common
    mean. What none of them sees gets the mean of the rest.

    This takes light for paint; the optimisation tells them apart, from a start that has every edge of the paint.
    """
    import trimesh

    points, normals = np.asarray(mesh.vertices, float), np.asarray(mesh.vertex_normals(), float)
    surface = trimesh.Trimesh(points, np.asarray(mesh.faces), process=False)
    total, weight = np.zeros_like(points), np.zeros(len(points))
    for cut in photographs:
        height, width, _ = cut.color.shape
        to_world = np.asarray(cut.camera.to_world, float)
        away = to_world[:3, 3] - points
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        cosine = np.einsum("ni,ni->n", away / distance, normals)
        facing = np.flatnonzero(cosine > 0.2)
        origins = points[facing] + LIFT * normals[facing]
        free = facing[~surface.ray.intersects_any(origins, (away / distance)[facing])]
        column, row = np.floor(_projected(points[free], cut, width, height)).astype(int)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        free, column, row = free[inside], column[inside], row[inside]
        share = cosine[free]
        if cut.alpha is not None:
            share = share * (cut.alpha[row, column] > 0.99)
        total[free] += share[:, None] * cut.color[row, column]
        weight[free] += share
    seen = weight > 0
    if not seen.any():
        return np.full_like(points, GREY)
    colors = total / np.where(seen, weight, 1.0)[:, None]
    mean = colors[seen].mean(0)
    colors = np.where(seen[:, None], colors, mean)
    return np.clip(colors * GREY / max(float(mean.mean()), 1e-6), DARKEST, BRIGHTEST)


def _projected(points: Float[np.ndarray, "n 3"], cut: Cut, width: int, height: int) -> Float[np.ndarray, "2 n"]:
    """Film points (pixels) on the host: JAX would compile anew for every number of points."""
    to_world, fov, axis = (np.asarray(x, float) for x in cut.camera)
    left, up, depth = ((points - to_world[:3, 3]) @ to_world[:3, :3]).T
    focal = 0.5 * width / np.tan(np.radians(fov) / 2)
    return np.stack([(0.5 - axis[0]) * width - focal * left / depth, (0.5 - axis[1]) * height - focal * up / depth])
