"""Tests whether two stacks of independent images have the same expected value, in each pixel and as a whole."""

import numpy as np
from scipy.stats import t

ROUNDING = 1e-5  # of float32 sums and look-ups, relative: where nothing is random, images agree to that


def compare(ours, theirs):
    """Statistics of two stacks of images [S, H, W, 3] and the z of every pixel and channel [H, W, 3].

    z = difference of the means over its standard error, which is estimated from the same images: a t-distribution with
    some 2 S - 2 degrees of freedom (Welch and Satterthwaite). `share` of |z| > 3 and what that distribution `expects`;
    `mean` and `deviation` of z, which should be 0 and `expected_deviation`; the whole image's relative difference and
    its standard error; `image_z`, the largest of the three channels' z.
    """
    ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
    parts = [(x.mean(0), x.var(0, ddof=1) / len(x), len(x) - 1) for x in (ours, theirs)]
    return compare_means(*parts, [x.mean((1, 2)) for x in (ours, theirs)])


def compare_means(one, two, channels):
    """`compare` from (mean, variance of the mean, degrees of freedom) and the images' mean colours [S, 3]."""
    (a, va, na), (b, vb, nb) = one, two
    floor = (ROUNDING * (np.abs(a) + np.abs(b)) + 1e-7) ** 2
    z = (a - b) / np.sqrt(va + vb + floor)
    freedom = (va + vb + floor) ** 2 / ((va**2) / na + (vb**2) / nb + floor**2 / (na + nb))
    expected = 2 * t.sf(3, freedom).mean()
    colors = [(c.mean(0), c.var(0, ddof=1) / len(c)) for c in channels]
    difference, error = colors[0][0] - colors[1][0], np.sqrt(colors[0][1] + colors[1][1])
    whole = [c.mean(1) for c in channels]
    brightness = whole[1].mean()
    whole_error = np.sqrt(sum(w.var(ddof=1) / len(w) for w in whole))
    numbers = {
        "share": np.mean(np.abs(z) > 3),
        "expects": expected,
        "mean": z.mean(),
        "deviation": z.std(),
        "expected_deviation": np.sqrt(np.mean(freedom / (freedom - 2))),
        "largest": np.abs(z).max(),
        "relative": (whole[0].mean() - brightness) / brightness,
        "relative_error": whole_error / brightness,
        "image_z": np.abs(difference / (error + ROUNDING * brightness)).max(),
    }
    # Channels of a pixel are not independent: as many independent z as pixels, at worst.
    pixels = z[..., 0].size
    allowed = expected + 4 * np.sqrt(expected / pixels)
    agrees = numbers["share"] <= allowed and numbers["image_z"] < 4 and numbers["deviation"] < 1.3
    return {**numbers, "allowed": allowed, "agrees": bool(agrees)}, z
