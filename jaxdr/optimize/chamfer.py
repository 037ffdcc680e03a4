"""Chamfer distance between surfaces."""

import numpy as np
from jaxtyping import Float, Int

from jaxdr.argument_kinds import checked
from jaxdr.geometry.mesh import Mesh


@checked
def chamfer(mesh: Mesh, target: Mesh, samples: int = 20_000, seed: int = 0) -> float:
    """Chamfer distance of two surfaces, as a share of the diagonal of the target's bounding box.

    It is half the sum of two mean distances (not squared): from points on `mesh` to the surface of `target`, and the
    other way round. Distances are exact, to the nearest point of any triangle. `samples` points are drawn on each
    surface, stratified by area. It runs on the host CPU; the same seed gives the same number.

    Raises ValueError for fewer than one sample, and for vertices that are not finite.
    """
    if samples < 1:
        raise ValueError(f"chamfer: samples must be at least 1, got {samples}")
    if seed < 0:
        raise ValueError(f"chamfer: seed must not be negative, got {seed}")
    surfaces = [(np.asarray(m.vertices, np.float64), np.asarray(m.faces)) for m in (mesh, target)]
    for name, (vertices, _) in zip(("mesh", "target"), surfaces, strict=True):
        if not np.isfinite(vertices).all():
            raise ValueError(f"chamfer: {name} has vertices that are not finite")

    from jaxdr.optimize.warp_distances import surface_distances  # on use: importing Warp takes long

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
