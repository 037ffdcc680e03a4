"""How much of a gradient can be relied on: its ratio of signal to noise."""

from jaxtyping import Array, Float


def signal_to_noise(a: Float[Array, "V 3"], b: Float[Array, "V 3"]) -> float:
    """<a, b> / (|a - b|² / 2): power of what two estimates of a gradient share, over that in which one differs from it.

    For a = s + e, b = s + e' with independent errors it is |s|² / E|e|², each part in expectation. About zero (of
    either sign) for noise alone, infinite where a and b are the same.
    """
    difference = float(((a - b) ** 2).sum()) / 2
    shared = float((a * b).sum())
    return shared / difference if difference > 0 else float("inf")
