"""Error of one derivative image, split into bias and standard deviation, all relative to the reference's size."""

import math

import numpy as np


def statistics(images, reference, noise_variance):
    """Errors of one call, from images [offsets, seeds, H, W, 3] whose offsets spread over the reference's step.

    Returns a dict, relative to the root mean square of the reference (its own noise removed):
    `deviation`: standard deviation of a call, from calls that share an offset;
    `bias`: root mean square of the mean's error, without what this spread and the reference's noise add to it. Where
    that difference comes out negative, nothing is left to see and `bias` is 0;
    `bias_resolution`: the size of what was taken off, so a bias well below it is not known;
    `error`: √(bias² + deviation²); `projection`: <mean, reference> / <reference, reference>.
    """
    seeds = images.shape[1]
    mean = images.mean((0, 1))
    power = np.mean(reference**2) - noise_variance
    deviation2 = images.var(1, ddof=1).mean()
    taken_off = deviation2 / (images.shape[0] * seeds) + noise_variance
    bias2 = max(np.mean((mean - reference) ** 2) - taken_off, 0.0)
    return {
        "error": math.sqrt((bias2 + deviation2) / power),
        "bias": math.sqrt(bias2 / power),
        "bias_resolution": math.sqrt(taken_off / power),
        "deviation": math.sqrt(deviation2 / power),
        "projection": float(np.mean(mean * reference) / power),
    }
