"""Pictures of a scene's derivatives, side by side: images at equal samples and equal time, gradients over a sphere."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial import KDTree

from jaxdr.images import diverging, labelled_grid

MAP = 96  # rows of a map of vertices; twice as many columns
BLACK = np.uint8(0)  # where an estimate is not finite


def images_picture(
    reference: Float[np.ndarray, "H W 3"], lines: Mapping[str, Sequence[Float[np.ndarray, "H W 3"]]]
) -> UInt8[np.ndarray, "h w 3"]:
    """The reference and the images of every line in a column each; colours end at the reference's 99th percentile."""
    limit = float(np.percentile(np.abs(reference.mean(-1)), 99)) or 1.0

    def colored(image):
        return diverging(image.mean(-1), limit) if np.isfinite(image).all() else np.full(image.shape, BLACK)

    rows = max(len(images) for images in lines.values())
    columns = [[reference] * rows, *lines.values()]
    grid = [[colored(column[min(row, len(column) - 1)]) for column in columns] for row in range(rows)]
    return labelled_grid(["reference", *lines], grid)


def vertices_picture(
    vertices: Float[np.ndarray, "V 3"], gradients: dict[str, Float[np.ndarray, "V 3"]]
) -> UInt8[np.ndarray, "h w 3"]:
    """Magnitudes of gradients by vertices over longitude and latitude (Xu et al. 2026, Fig. 11), one under another.

    A pixel has the value of the vertex whose direction from the middle of the shape is closest. North (+z) is on top,
    and the middle is +x. White is zero; colours end at the 99th percentile of the first gradient.
    """
    nearest = nearest_vertices(vertices)
    sizes = {name: np.linalg.norm(gradient, axis=-1) for name, gradient in gradients.items()}
    limit = float(np.percentile(next(iter(sizes.values())), 99)) or 1.0
    cells = [
        diverging(size[nearest], limit) if np.isfinite(size).all() else np.full((*nearest.shape, 3), BLACK)
        for size in sizes.values()
    ]
    return labelled_grid(list(sizes), [cells])


def nearest_vertices(vertices: Float[np.ndarray, "V 3"]) -> np.ndarray:
    """Number of the vertex that belongs to every pixel [MAP, 2 MAP] of a map of longitude and latitude."""
    arms = vertices - (vertices.min(0) + vertices.max(0)) / 2
    directions = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    latitude = np.pi * (0.5 - (np.arange(MAP) + 0.5) / MAP)
    longitude = np.pi * ((np.arange(2 * MAP) + 0.5) / MAP - 1)
    latitude, longitude = np.meshgrid(latitude, longitude, indexing="ij")
    flat = np.cos(latitude)
    grid = np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)], -1)
    return np.asarray(KDTree(directions).query(grid)[1])
