"""Distances from points to surfaces, by Warp on the host."""

from typing import no_type_check

import numpy as np
import warp as wp
from jaxtyping import Float, Int

from jaxdr.quiet_warp import load_module, start_warp


def surface_distances(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " N"]:
    """Distance from each point to the nearest point of the triangles, in the units of the input; float32 accuracy."""
    start_warp()
    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
        indices=wp.array(np.asarray(faces, np.int32).ravel(), dtype=wp.int32, device="cpu"),
    )
    reach = float(np.linalg.norm(np.ptp(np.concatenate([points, vertices]), axis=0)))
    distance = wp.empty(len(points), dtype=float, device="cpu")
    inputs = [mesh.id, wp.array(points, dtype=wp.vec3, device="cpu"), 2.0 * reach, distance]
    load_module(_surface_distance, "cpu")
    wp.launch(_surface_distance, dim=len(points), inputs=inputs, device="cpu")
    return distance.numpy()


@wp.kernel
@no_type_check  # Warp's annotations are not types
def _surface_distance(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: float, distance: wp.array(dtype=float)):
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], reach)
    nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    distance[i] = wp.length(points[i] - nearest)
