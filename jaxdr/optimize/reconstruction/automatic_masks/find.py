"""Masks for photographs without any: rounds of cutting out and agreeing."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.automatic_masks.consensus import agreed_solid, next_guess, overlap, silhouette
from jaxdr.optimize.reconstruction.automatic_masks.pictures import Guess, cut_out, first_guess
from jaxdr.optimize.reconstruction.automatic_masks.region import Region, find_region
from jaxdr.optimize.reconstruction.opencv import require_cv2
from jaxdr.views.reading import read_ahead
from jaxdr.views.record import Views
from jaxdr.views.sparse_points import SparsePoints, sparse_points

# Of the longer side: how far the border of a mask may be from that of the solid of the round before. Thin parts that
# few photographs showed at first come back while it is far.
NEAR = (0.12, 0.08, 0.03)
GOOD = 0.7  # overlap with what the agreed solid covers; photographs with less are left out
SMALL = 0.002  # share of a photograph that the object covers at least
ELSEWHERE = (
    "make masks with another program (white where the object is, NAME.png for NAME.jpg) and give their folder with "
    "--masks"
)


class Found(NamedTuple):
    """Masks of photographs, in their order, and how well each agrees with the `solid` that most of them agree on."""

    masks: list[Bool[np.ndarray, "H W"]]
    overlaps: list[float]
    solid: Mesh

    @property
    def good(self) -> list[bool]:
        """Which of them are to be used."""
        pairs = zip(self.masks, self.overlaps, strict=True)
        return [bool(share >= GOOD and mask.mean() >= SMALL) for mask, share in pairs]

    def to_dict(self) -> dict:
        """How many masks were found and left out, and their mean overlap with the solid."""
        good = self.good
        kept = [share for share, use in zip(self.overlaps, good, strict=True) if use]
        return {"found": sum(good), "left_out": len(good) - sum(good), "overlap": float(np.mean(kept))}


def find_masks(views: Views, seed: int, say: Callable[[str], None]) -> Found:
    """Masks of all photographs; the same seed gives the same bits.

    Raises ValueError, with what to do, where photographs do not agree on an object; ImportError without OpenCV.
    """
    require_cv2()
    photographs, points = views.views, sparse_points(views)
    region = find_region(photographs, points, seed)
    saw = np.zeros((len(photographs), 0), bool) if points is None else points.saw
    guesses = [first_guess(view, region, points) for view in photographs]
    masks: list[Bool[np.ndarray, "H W"]] = []
    overlaps: list[float] = []
    solid: Mesh | None = None
    for number in range(1 + len(NEAR)):
        say(f"masks: round {number + 1} of {1 + len(NEAR)}, {len(photographs)} photographs")
        masks = _all_cut(views, guesses, region, points, saw)
        try:
            solid = agreed_solid(photographs, masks, region)
        except ValueError as problem:
            raise ValueError(f"{views.folder}: no masks were found: {problem}; {ELSEWHERE}") from None
        if number < len(NEAR):
            guesses = [next_guess(view, solid, NEAR[number]) for view in photographs]
        overlaps = [overlap(mask, silhouette(view, solid)) for view, mask in zip(photographs, masks, strict=True)]
    assert solid is not None  # there is at least one round
    found = Found(masks, overlaps, solid)
    if 2 * sum(found.good) < len(photographs):
        raise ValueError(
            f"{views.folder}: no masks were found: photographs do not agree on an object, {sum(found.good)} of "
            f"{len(photographs)} masks are good; {ELSEWHERE}"
        )
    return found


def _all_cut(
    views: Views, guesses: Sequence[Guess], region: Region, points: SparsePoints | None, saw: Bool[np.ndarray, "V N"]
) -> list[Bool[np.ndarray, "H W"]]:
    numbers = range(len(views.views))
    return list(read_ahead(lambda i: cut_out(views.views[i], guesses[i], region, points, saw[i]), numbers))


def with_masks(views: Views, found: Found) -> Views:
    """The photographs whose masks are good, cut out by them."""
    chosen = [
        dataclasses.replace(view, picture=view.picture.cut_by(mask))
        for view, mask, good in zip(views.views, found.masks, found.good, strict=True)
        if good
    ]
    return dataclasses.replace(views, views=tuple(chosen))
