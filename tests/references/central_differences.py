"""Derivatives by central differences."""

import numpy as np


def central(function, at, step=1e-5):
    """Derivatives of a number by every component of `at`."""
    result = np.zeros_like(at)
    for index in np.ndindex(at.shape):
        shift = np.zeros_like(at)
        shift[index] = step
        result[index] = (function(at + shift) - function(at - shift)) / (2 * step)
    return result
