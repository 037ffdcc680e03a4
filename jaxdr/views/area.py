"""Pictures made smaller: every new pixel is the mean of the area that it covers."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

ROWS = 1 << 22  # numbers of a strip of the larger picture at once

Rows = Callable[[int, int], Float[np.ndarray, "h w C"]]


def area_mean(
    rows: Rows, size: tuple[int, int], new: tuple[int, int], shares: tuple[float, float], channels: int
) -> Float[np.ndarray, "H W C"]:
    """A picture of `new` (width, height), whose pixels are means over the area of a larger one of this `size`.

    `rows(first, end)` are rows of the larger one, as numbers that may be added up, such as linear light. `shares`: new
    pixels for one old pixel, along x and y, at most 1. Both pictures begin at the same upper left corner.
    """
    across, down = (_weights(*sides) for sides in zip(size, new, shares, strict=True))
    made = np.empty((new[1], new[0], channels), np.float32)
    step = max(1, int(ROWS / (size[0] * channels) * shares[1]))
    for first in range(0, new[1], step):
        end = min(first + step, new[1])
        low, high = int(first / shares[1]), min(size[1], int(np.ceil(end / shares[1] - 1e-6)))
        strip = rows(low, high)
        lowered = down[first:end, low:high] @ strip.reshape(high - low, -1)
        narrow = across @ lowered.reshape(end - first, size[0], channels).swapaxes(0, 1).reshape(size[0], -1)
        made[first:end] = narrow.reshape(new[0], end - first, channels).swapaxes(0, 1)
    return made


def _weights(old: int, new: int, share: float):
    """Sparse [new, old]: which part of every new pixel an old one covers."""
    from scipy.sparse import csr_matrix

    edges = np.minimum(np.arange(new + 1) / share, old)
    first = np.minimum(np.floor(edges[:-1] + 1e-9).astype(int), old - 1)
    reach = int(np.ceil(1 / share)) + 1
    columns = first[:, None] + np.arange(reach)
    covered = np.minimum(columns + 1, edges[1:, None]) - np.maximum(columns, edges[:-1, None])
    covered = np.maximum(covered, 0.0)
    covered /= covered.sum(1, keepdims=True)
    chosen = (columns < old) & (covered > 1e-9)
    place = np.nonzero(chosen)[0]
    return csr_matrix((covered[chosen].astype(np.float32), (place, columns[chosen])), (new, old))
