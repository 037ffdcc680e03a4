"""Chamfer distance between surfaces."""

from typing import no_type_check

import numpy as np
import warp as wp
from jaxtyping import Float, Int

from jaxdr.geometry.mesh import Mesh


def chamfer(mesh: Mesh, target: Mesh, samples: int = 20_000, seed: int = 0) -> float:
    """Chamfer distance of two surfaces, as a share of the diagonal of the target's bounding box.

    Half the sum of the two mean distances (not squared): from points on `mesh` to the surface of `target`, and
    the other way round. Distances are exact, to the nearest point of any triangle; the `samples` points on each
    surface are stratified by area. Computed on the host CPU; the same seed gives the same number.

    Raises ValueError for fewer than one sample or vertices that are not finite.
    """
    if samples < 1:
        raise ValueError(f"chamfer: samples must be at least 1, got {samples}")
    surfaces = [(np.asarray(m.vertices, np.float64), np.asarray(m.faces)) for m in (mesh, target)]
    for name, (vertices, _) in zip(("mesh", "target"), surfaces, strict=True):
        if not np.isfinite(vertices).all():
            raise ValueError(f"chamfer: {name} has vertices that are not finite")

    # Warp works in float32: bring the target into the unit box, so that an offset of the scene costs no digits.
    corners = surfaces[1][0][np.unique(surfaces[1][1])]
    low, high = corners.min(0), corners.max(0)
    diagonal = float(np.linalg.norm(high - low))
    a, b = ((((vertices - (low + high) / 2) / diagonal), faces) for vertices, faces in surfaces)

    generator = np.random.default_rng(seed)
    there = surface_distances(sample_surface(*a, samples, generator), *b)
    back = surface_distances(sample_surface(*b, samples, generator), *a)
    return float(there.mean() + back.mean()) / 2


def sample_surface(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int, generator: np.random.Generator
) -> Float[np.ndarray, "count 3"]:
    """Points spread uniformly by area over triangles, stratified along the running sum of the areas."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    cumulative = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    position = (np.arange(count) + generator.random(count)) / count * cumulative[-1]
    face = np.minimum(np.searchsorted(cumulative, position, side="right"), len(faces) - 1)
    root, v = np.sqrt(generator.random((count, 1))), generator.random((count, 1))
    return (1 - root) * a[face] + root * (1 - v) * b[face] + root * v * c[face]


def surface_distances(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " N"]:
    """Distance from each point to the nearest point of the triangles, in the units of the input; float32 accuracy."""
    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
        indices=wp.array(np.asarray(faces, np.int32).ravel(), dtype=wp.int32, device="cpu"),
    )
    reach = float(np.linalg.norm(np.ptp(np.concatenate([points, vertices]), axis=0)))
    distance = wp.empty(len(points), dtype=float, device="cpu")
    inputs = [mesh.id, wp.array(points, dtype=wp.vec3, device="cpu"), 2.0 * reach, distance]
    wp.launch(_surface_distance, dim=len(points), inputs=inputs, device="cpu")
    return distance.numpy()


@wp.kernel
@no_type_check  # Warp's annotations are not types
def _surface_distance(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: float, distance: wp.array(dtype=float)):
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], reach)
    nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    distance[i] = wp.length(points[i] - nearest)
