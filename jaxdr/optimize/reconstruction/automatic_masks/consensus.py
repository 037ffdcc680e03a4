"""The solid on which most photographs agree, and what it covers in each of them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.automatic_masks.pictures import BALL, Guess
from jaxdr.optimize.reconstruction.automatic_masks.region import Region
from jaxdr.optimize.reconstruction.hull import outward
from jaxdr.optimize.reconstruction.opencv import require_cv2
from jaxdr.views.record import View

CELLS = 72  # along the cube around the ball
AGREED = 0.7  # share of the photographs that show a cell and have the object there
SHOWN = 0.25  # share of the photographs that a cell must be in
FINE = 4  # bits of a fraction of a pixel

Masks = Sequence[Bool[np.ndarray, "H W"]]


def agreed_solid(views: Sequence[View], masks: Masks, region: Region) -> Mesh:
    """The surface of the largest piece of which most photographs say that the object is there.

    Raises ValueError where they agree on nothing.
    """
    from scipy.ndimage import gaussian_filter
    from skimage.measure import label, marching_cubes

    axis = np.linspace(-BALL * region.radius, BALL * region.radius, CELLS)
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + region.centre
    inside, shown = np.zeros(len(cells)), np.zeros(len(cells))
    for view, mask in zip(views, masks, strict=True):
        framed, row, column = view.pixels(cells)
        inside += framed & mask[row, column]
        shown += framed
    share = np.where(shown >= SHOWN * len(views), inside / np.maximum(shown, 1), 0.0)
    if region.support is not None:
        share = np.where(region.support.height(cells) < -region.thickness, 0.0, share)
    # Smooth over a cell: the border of a share of some photographs is ragged.
    share = gaussian_filter(share.reshape(CELLS, CELLS, CELLS), 1.0)
    pieces = np.asarray(label(share > AGREED, connectivity=1))
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    if not sizes.any():
        raise ValueError("the photographs agree on no object")
    # The surface of one piece; a node at the level itself would make faces without area.
    one = np.where((share > AGREED) & (pieces != sizes.argmax()), AGREED - 0.1, share)
    one = np.where(np.abs(one - AGREED) < 1e-4, AGREED - 1e-4, one)
    vertices, faces, _, _ = marching_cubes(np.pad(one, 1), AGREED, gradient_direction="ascent")
    return Mesh((vertices - 1) * (axis[1] - axis[0]) + axis[0] + region.centre, outward(vertices, faces))


def silhouette(view: View, solid: Mesh) -> Bool[np.ndarray, "H W"]:
    """What a solid covers in a photograph."""
    cv2 = require_cv2()
    x, y, depth = view.project(np.asarray(solid.vertices, float))
    faces = np.asarray(solid.faces)
    ahead = (depth[faces] > 0).all(1)
    corners = np.clip(np.stack([x, y], -1)[faces[ahead]], -1e4, 1e4)
    made = np.zeros((view.height, view.width), np.uint8)
    for triangle in np.round((corners - 0.5) * 2**FINE).astype(np.int32):
        cv2.fillConvexPoly(made, triangle, 1, cv2.LINE_8, FINE)
    return made > 0


def next_guess(view: View, solid: Mesh, near: float) -> Guess:
    """The object's border is near that of the solid: so far away at most, as a share of the longer side."""
    cv2 = require_cv2()
    covered = silhouette(view, solid)
    reach = max(2, round(near * max(view.width, view.height)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    wide, narrow = (change(covered.astype(np.uint8), disc) > 0 for change in (cv2.dilate, cv2.erode))
    return Guess(wide, covered, narrow)


def overlap(one: Bool[np.ndarray, "H W"], other: Bool[np.ndarray, "H W"]) -> float:
    """Intersection over union; 1 where both are empty."""
    union = (one | other).sum()
    return float((one & other).sum() / union) if union else 1.0
