"""The first surface: the visual hull of the masks, or a sphere."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from jaxdr.geometry import shapes
from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.views.reading import Kept, read_ahead
from jaxdr.views.record import View, common_point

COARSE = 48  # cells along the cube in which the object is looked for
CELLS = 1 << 20  # cells at once
KEEP = 1 << 30
CLEAR = 1e-2  # of a cell: the surface stays so far away from nodes of the grid
SMALL = 0.02  # pieces of the hull of less than this share of its volume are phantoms


def initial_surface(views: Sequence[View], kind: str, grid: int, keep: int = KEEP) -> tuple[Mesh, Pose]:
    """(a closed mesh in its own frame, where the longest side is 1; where that is in the world of the cameras).

    `kind`: "hull", "sphere". `keep`: bytes of distances to outlines that are not computed twice. Raises ValueError
    where a hull is asked for without masks, and where it is empty.
    """
    if kind == "sphere":
        return _sphere(views)
    if not all(view.masked for view in views):
        raise ValueError('start.kind: "hull" needs a mask or alpha of every photograph; take "sphere"')
    return in_own_frame(*visual_hull(views, grid, keep))


def in_own_frame(vertices: Float[np.ndarray, "V 3"], faces: np.ndarray) -> tuple[Mesh, Pose]:
    """(a mesh whose longest side is 1, around the origin; where that is)."""
    lower, upper = vertices.min(0), vertices.max(0)
    pose = Pose((lower + upper) / 2, float((upper - lower).max()))
    return Mesh((vertices - pose.centre) / pose.scale, faces), pose


def _sphere(views: Sequence[View]) -> tuple[Mesh, Pose]:
    """A sphere around the point that the cameras look at, half as wide as what the nearest of them sees."""
    centre, reach = look(views)
    mesh = shapes.sphere(4, radius=0.5)
    return mesh, Pose(centre, reach)


def look(views: Sequence[View]) -> tuple[Float[np.ndarray, "3"], float]:
    """(the point that the cameras look at, half the width of what the narrowest view sees there)."""
    poses = np.stack([view.to_world for view in views])
    centre = common_point(poses)
    depths = np.einsum("ni,ni->n", centre - poses[:, :3, 3], poses[:, :3, 2])
    sides = np.array([0.5 * min(view.width, view.height) / view.focal for view in views])
    reaches = (depths * sides)[depths > 0]
    if not len(reaches):
        raise ValueError("the cameras look at nothing in common; check the poses")
    return centre, float(reaches.min())


def visual_hull(views: Sequence[View], grid: int, keep: int) -> tuple[Float[np.ndarray, "V 3"], np.ndarray]:
    """(vertices, faces) of the surface that fills all masks, outside of the frame undecided; in the world.

    Every cell gets the least signed distance of all views: to the outline in the image, times depth over focal length.
    The surface is the zero level of that (marching cubes). Raises ValueError where no cell is inside of all masks.
    """
    kept = Kept(keep)

    def field(view: View) -> Float[np.ndarray, "H W"]:
        return kept.get(view, lambda: _signed_distance(np.asarray(view.alpha)))

    def fields() -> Iterator[Float[np.ndarray, "H W"]]:
        return read_ahead(field, views)

    centre, reach = look(views)
    low, high = centre - 1.5 * reach, centre + 1.5 * reach
    values = _least(views, fields(), low, high, (COARSE,) * 3)
    inside = np.argwhere(values > -1.5 * 3 * reach / COARSE)
    if not (values > 0).any() and not len(inside):
        raise ValueError('the masks have no volume in common; check masks and cameras, or take start.kind = "sphere"')
    cell = (high - low) / (COARSE - 1)
    low, high = low + (inside.min(0) - 1) * cell, low + (inside.max(0) + 1) * cell
    counts = np.maximum(np.ceil((high - low) / (high - low).max() * grid).astype(int), 8)
    values = _least(views, fields(), low, high, tuple(counts))
    if not (values > 0).any():
        raise ValueError('the masks have no volume in common; check masks and cameras, or take start.kind = "sphere"')
    return surface_of(values, low, (high - low) / (counts - 1))


def _signed_distance(alpha: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """Distance (pixels) to the outline, positive inside."""
    from scipy.ndimage import distance_transform_edt

    inside = alpha > 0.5
    within, without = (np.asarray(distance_transform_edt(side)) for side in (inside, ~inside))
    return np.where(inside, within - 0.5, 0.5 - without)


def _least(views, fields, low, high, counts) -> Float[np.ndarray, "X Y Z"]:
    from scipy.ndimage import map_coordinates

    axes = [np.linspace(low[i], high[i], counts[i]) for i in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    least, seen = np.full(len(points), np.inf), np.zeros(len(points), int)
    for view, field in zip(views, fields, strict=True):
        for start in range(0, len(points), CELLS):
            part = slice(start, start + CELLS)
            x, y, depth = view.project(points[part])
            framed = (depth > 0) & (x >= 0) & (x <= view.width) & (y >= 0) & (y <= view.height)
            value = map_coordinates(field, [y - 0.5, x - 0.5], order=1, mode="nearest") * depth / view.focal
            least[part] = np.where(framed, np.minimum(least[part], value), least[part])
            seen[part] += framed
    # What few cameras see can't be told to be empty, and is not the object either.
    unknown = seen < max(1, len(views) // 2)
    return np.where(unknown, np.minimum(least, -float(np.max(high - low)) / max(counts)), least).reshape(counts)


def surface_of(
    values: Float[np.ndarray, "X Y Z"], low: Float[np.ndarray, "3"], cell: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "V 3"], np.ndarray]:
    """(vertices, faces) of the closed surface around positive values on a grid, without its small pieces.

    `low`: where the first node is; `cell`: sides of a cell.
    """
    from skimage.measure import label, marching_cubes

    pieces = np.asarray(label(values > 0, connectivity=1))
    sizes = np.bincount(pieces.ravel(), minlength=2)
    sizes[0] = 0
    keep = np.flatnonzero(sizes >= SMALL * sizes.sum())
    away = -0.5 * float(cell.min())
    values = np.where((values > 0) & ~np.isin(pieces, keep), away, values)
    # A surface through a node of the grid has several vertices there, and faces without area.
    least = CLEAR * float(cell.min())
    values = np.where(np.abs(values) < least, np.copysign(least, values), values)
    values = np.pad(values, 1, constant_values=min(away, float(values.min())))
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=tuple(cell), gradient_direction="ascent")
    return vertices.astype(float) + low - cell, outward(vertices, faces)


def outward(vertices: Float[np.ndarray, "V 3"], faces: np.ndarray) -> np.ndarray:
    """The faces of a closed surface, turned so that their normals point out of it."""
    corners = vertices[faces]
    inward = np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0
    return np.ascontiguousarray(faces[:, ::-1] if inward else faces)
