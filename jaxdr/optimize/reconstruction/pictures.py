"""Photographs as a level needs them: reduced, cut to one size around the object, cameras to go with them."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.optimize.reconstruction.cameras import corrected
from jaxdr.optimize.reconstruction.evenly import evenly
from jaxdr.views.area import area_mean
from jaxdr.views.reading import THREADS, Kept, read_ahead
from jaxdr.views.record import View, over_black
from jaxdr.views.rendering import Pinhole

MARGIN = 0.03  # of the longer side of the window, around the object
MULTIPLE = 8  # pixels: what the sides of a window are multiples of

Bounds = tuple[int, int, int, int]
Reduced = tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"] | None, Float[np.ndarray, "H W"]]


class Pose(NamedTuple):
    """Where the object is in the world of the cameras: `centre`, and the `scale` of its longest side."""

    centre: Float[np.ndarray, "3"]
    scale: float

    def moved(self, to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """The pose of a camera in the frame of the object, where its longest side is 1."""
        moved = np.array(to_world, float)
        moved[:3, 3] = (moved[:3, 3] - self.centre) / self.scale
        return moved


class Cut(NamedTuple):
    """A photograph of a level: `color` linear, over black where there is `alpha`, and its camera.

    `trust`: share of a pixel whose colour is the object's or black for certain. Pixels at the border of a mask show
    both the object and what is behind it. `framed`: 1 in the photograph, 0 around one that is smaller than others.
    """

    color: Float[np.ndarray, "H W 3"]
    alpha: Float[np.ndarray, "H W"] | None
    trust: Float[np.ndarray, "H W"]
    framed: Float[np.ndarray, "H W"]
    camera: Pinhole


class Photographs:
    """The photographs reduced to `resolution` pixels along their longer side, and cut to one size around the object.

    Without masks nothing is cut off. Photographs that are smaller than that have a border. Light is averaged over the
    area of the new pixels. They are read when they are asked for, or ahead of that (`expect`); `kept` has as many as
    fit. `bounds`: of the objects, see `object_bounds`. `corrections`: of the cameras. `exposure`: logarithms of the
    factors by which photographs are too bright; their colours are divided by them.
    """

    def __init__(
        self,
        views: Sequence[View],
        bounds: Sequence[Bounds | None],
        pose: Pose,
        resolution: int,
        kept: Kept,
        corrections: Float[Array, "N 6"] | None = None,
        exposure: Float[np.ndarray, "N 3"] | None = None,
    ):
        self.views, self.bounds, self.pose, self.resolution, self.kept = views, bounds, pose, resolution, kept
        self._corrections, self._exposure = corrections, exposure
        sizes = [reduced_size(view, resolution) for view in views]
        self.height, self.width = _window_size(bounds, (max(h for _, h in sizes), max(w for w, _ in sizes)))
        self._expected: dict[int, Future] = {}
        self._pool = ThreadPoolExecutor(THREADS, "jaxdr read")  # its threads begin when there is something to read

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, number: int) -> Cut:
        if not 0 <= number < len(self.views):
            raise IndexError(number)
        expected = self._expected.get(number)
        return self._cut(number, expected.result() if expected else self._read(number))

    def __iter__(self) -> Iterator[Cut]:
        for number, reduced in enumerate(read_ahead(self._read, range(len(self.views)))):
            yield self._cut(number, reduced)

    def camera(self, number: int) -> Pinhole:
        """The camera of one of them; nothing is read for that."""
        view, (x0, y0) = self.views[number], self._corner(number)
        share = _share(view, self.resolution)
        focal = view.focal * share
        centre = view.centre[0] * share - x0, view.centre[1] * share - y0
        fov = np.degrees(2 * np.arctan(0.5 * self.width / focal))
        axis = (0.5 - centre[0] / self.width, 0.5 - centre[1] / self.height)
        to_world = self.pose.moved(view.to_world)
        if self._corrections is not None:
            to_world = corrected(to_world, self._corrections[number])
        return Pinhole(*(jnp.asarray(x, float) for x in (to_world, fov, axis)))

    def expect(self, numbers: Iterable[int]) -> None:
        """Read these ahead, in this order, beside what goes on. Those that were expected before are let go."""
        expected = {}
        for number in numbers:
            if number not in expected and (self.views[number], self.resolution) not in self.kept:
                expected[number] = self._expected.get(number) or self._pool.submit(self._read, number)
        for number, future in self._expected.items():
            if number not in expected:
                future.cancel()
        self._expected = expected

    def spread(self, count: int) -> "Photographs":
        """At most so many of them, spread evenly over all."""
        if count >= len(self):
            return self
        chosen = evenly(len(self), count)
        corrections = None if self._corrections is None else self._corrections[chosen]
        exposure = None if self._exposure is None else self._exposure[chosen]
        return self._some(chosen.tolist(), corrections, exposure)

    def with_corrections(
        self, corrections: Float[Array, "N 6"] | None, exposure: Float[np.ndarray, "N 3"] | None = None
    ) -> "Photographs":
        """All of them, with corrected cameras and of one exposure, as far as these are given."""
        return self._some(list(range(len(self))), corrections, exposure)

    def _some(
        self, chosen: list[int], corrections: Float[Array, "M 6"] | None, exposure: Float[np.ndarray, "M 3"] | None
    ) -> "Photographs":
        views, bounds = [self.views[i] for i in chosen], [self.bounds[i] for i in chosen]
        return Photographs(views, bounds, self.pose, self.resolution, self.kept, corrections, exposure)

    def _read(self, number: int) -> Reduced:
        view = self.views[number]
        return self.kept.get((view, self.resolution), lambda: _reduced(view, self.resolution))

    def _cut(self, number: int, reduced: Reduced) -> Cut:
        color, alpha, trust = reduced
        if self._exposure is not None:
            color = color / np.exp(self._exposure[number]).astype(color.dtype)
        x0, y0 = self._corner(number)
        height, width = trust.shape
        rows, columns = _within(y0, self.height, height), _within(x0, self.width, width)
        border = (rows.start - y0, self.height - rows.stop + y0), (columns.start - x0, self.width - columns.stop + x0)

        def window(pixels: np.ndarray) -> np.ndarray:
            found = pixels[rows, columns]
            return np.pad(found, (*border, (0, 0))[: found.ndim]) if np.any(border) else found

        cut_alpha = None if alpha is None else window(alpha)
        return Cut(window(color), cut_alpha, window(trust), window(np.ones_like(trust)), self.camera(number))

    def _corner(self, number: int) -> tuple[int, int]:
        """Upper left corner of the window around the object, in pixels of the reduced photograph."""
        sizes, window = reduced_size(self.views[number], self.resolution), (self.width, self.height)
        bounds = self.bounds[number]
        x0, y0, x1, y1 = bounds or (0, 0, *sizes)
        middles = (x0 + x1 - self.width) // 2, (y0 + y1 - self.height) // 2
        x, y = (
            min(max(middle, 0), all_ - side) if all_ >= side else (all_ - side) // 2
            for middle, all_, side in zip(middles, sizes, window, strict=True)
        )
        return x, y


def _within(start: int, count: int, every: int) -> slice:
    return slice(max(start, 0), min(start + count, every))


def object_bounds(views: Sequence[View], resolutions: Iterable[int]) -> dict[int, list[Bounds | None]]:
    """(x0, y0, x1, y1) of the object in all photographs, reduced to each of the resolutions; None without alpha.

    All photographs are read once. Raises ValueError that names a file that can't be read, or whose object is so small
    that nothing of it is left.
    """
    resolutions = list(dict.fromkeys(resolutions))

    def found(view: View) -> list[Bounds | None]:
        _, alpha = view.picture.read()
        if alpha is None:
            return [None] * len(resolutions)
        return [_bounds(view, resolution, alpha) for resolution in resolutions]

    columns = zip(*read_ahead(found, views), strict=True)
    return {resolution: list(column) for resolution, column in zip(resolutions, columns, strict=True)}


def cuts(views: Sequence[View], pose: Pose, resolution: int, keep: int = 0) -> Photographs:
    """The photographs for one resolution, of which as many are kept as fit into so many bytes."""
    return Photographs(views, object_bounds(views, [resolution])[resolution], pose, resolution, Kept(keep))


def reduced_size(view: View, resolution: int) -> tuple[int, int]:
    """(width, height) of a photograph that is reduced to `resolution` pixels along its longer side."""
    share = _share(view, resolution)
    return max(1, round(view.width * share)), max(1, round(view.height * share))


def _share(view: View, resolution: int) -> float:
    """Pixels of a reduced photograph for one of the photograph's."""
    return min(1.0, resolution / max(view.width, view.height))


def _reduced(view: View, resolution: int) -> Reduced:
    """(colours over black, alpha, trust)."""
    image, alpha = view.picture.read()
    color = _averaged(over_black(image, alpha), view, resolution)
    trust = _averaged(_trust(view, alpha)[..., None], view, resolution)[..., 0]
    return color, None if alpha is None else _averaged(alpha[..., None], view, resolution)[..., 0], trust


def _trust(view: View, alpha: Float[np.ndarray, "H W"] | None) -> Float[np.ndarray, "H W"]:
    """0 beside the border of a mask, else 1."""
    if alpha is None or not view.backdrop:
        return np.ones((view.height, view.width), np.float32)
    from scipy.ndimage import maximum_filter, minimum_filter

    same = maximum_filter(alpha, 3) == minimum_filter(alpha, 3)
    return same.astype(np.float32)


def _averaged(pixels: Float[np.ndarray, "H W C"], view: View, resolution: int) -> Float[np.ndarray, "h w C"]:
    size, share = reduced_size(view, resolution), _share(view, resolution)
    if share == 1:
        return pixels
    whole = view.width, view.height
    return area_mean(lambda first, end: pixels[first:end], whole, size, (share, share), pixels.shape[2])


def _bounds(view: View, resolution: int, alpha: Float[np.ndarray, "H W"]) -> Bounds:
    alpha = _averaged(alpha[..., None], view, resolution)[..., 0]
    rows, columns = np.flatnonzero((alpha > 0.1).any(1)), np.flatnonzero((alpha > 0.1).any(0))
    if not len(rows):
        raise ValueError(
            f"{view.path}: the object is so small that nothing of it is left with {resolution} pixels; take larger "
            "levels, or take this photograph out"
        )
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _window_size(bounds: Sequence[Bounds | None], full: tuple[int, int]) -> tuple[int, int]:
    """(height, width) of a window that holds the object of every photograph, with a margin."""
    boxes = [box for box in bounds if box is not None]
    if len(boxes) < len(bounds):
        return full
    sides = max(b[3] - b[1] for b in boxes), max(b[2] - b[0] for b in boxes)
    margin = 2 * round(MARGIN * max(sides)) + 4
    height, width = (
        min(-(-(side + margin) // MULTIPLE) * MULTIPLE, all) for side, all in zip(sides, full, strict=True)
    )
    return height, width
