"""Some of many."""

import numpy as np
from jaxtyping import Int


def evenly(count: int, most: int) -> Int[np.ndarray, " n"]:
    """Numbers below `count`, in order and spread evenly: all of them, or `most` if there are more."""
    return np.linspace(0, count - 1, min(most, count)).round().astype(int)
