"""The fitted photographs of a run: what all levels ask them for, in bounded memory."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Array, Float

from jaxdr.optimize.reconstruction.evenly import evenly
from jaxdr.optimize.reconstruction.pictures import Photographs, Pose, object_bounds
from jaxdr.optimize.reconstruction.seen_points import SeenPoints
from jaxdr.optimize.reconstruction.sky import Backdrop, find_backdrop
from jaxdr.views.reading import Kept
from jaxdr.views.record import View

SOME = 256  # photographs that tell the first paint and the sky: more of them change a median and a mean little


class PhotoSet:
    """Photographs with a `pose` of the object, for levels of some `resolutions`; `keep` bytes of reduced ones are kept.

    All photographs are read once when this is made, so that a bad one is told before anything else is done. Raises
    ValueError as `object_bounds` does.
    """

    def __init__(self, views: Sequence[View], resolutions: Iterable[int], keep: int):
        self.views, self.resolutions = views, tuple(resolutions)
        self.bounds = object_bounds(views, self.resolutions)
        self.kept = Kept(keep)
        self.pose = Pose(np.zeros(3), 1.0)  # until the first surface tells
        self.exposure = np.zeros((len(views), 3))  # until it is known
        self.seen: SeenPoints | None = None
        self._current: Photographs | None = None
        self._backdrops: dict[int, Backdrop | None] = {}

    @property
    def masked(self) -> bool:
        """Whether every photograph says where the object is."""
        return all(view.masked for view in self.views)

    def at(self, resolution: int) -> Photographs:
        """The photographs for a resolution. Those that were kept for another resolution are let go."""
        if self._current is None or self._current.resolution != resolution:
            if self._current is not None:
                self._current.expect(())
            self.kept.clear()
            self._current = Photographs(self.views, self.bounds[resolution], self.pose, resolution, self.kept)
        return self._current

    def paint(
        self, cameras: Float[Array, "N 6"] | None = None, exposure: Float[np.ndarray, "N 3"] | None = None
    ) -> Photographs:
        """The photographs of the highest resolution, or some of them, from which the first colours are taken.

        `cameras`: corrections of their poses. `exposure`: of each, if it is no longer the first one.
        """
        exposure = self.exposure if exposure is None else exposure
        return self.at(max(self.resolutions)).with_corrections(cameras, exposure).spread(SOME)

    def backdrop(self, rows: int) -> Backdrop | None:
        """The sky behind the object, from the photographs or some of them; see `find_backdrop`."""
        if rows not in self._backdrops:
            some = evenly(len(self.views), SOME)
            self._backdrops[rows] = find_backdrop([self.views[i] for i in some], rows, self.exposure[some])
        return self._backdrops[rows]
