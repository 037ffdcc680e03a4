"""Maps from uniform numbers in [0, 1)^2 to directions, disks and triangles; discrete choices; weights of strategies."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr import loops
from jaxdr.geometry.vector import components, from_components
from jaxdr.safe_divide import safe_divide

EVENLY = 0.1  # share of a choice among emitters that does not depend on their light
LEAST = 0.05  # least probability of sampling either of two lobes


def cosine_hemisphere(u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Directions around +z with density cos/pi (solid angle)."""
    first, second = components(u)
    radius, angle = jnp.sqrt(first), 2 * math.pi * second
    z = jnp.sqrt(jnp.maximum(1.0 - first, 0.0))
    return from_components(radius * jnp.cos(angle), radius * jnp.sin(angle), z)


def uniform_disk(u: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Points of the unit disk, uniform in area (Shirley and Chiu 1997, concentric squares to circles)."""
    x, y = (2.0 * part - 1.0 for part in components(u))
    across = jnp.abs(x) > jnp.abs(y)
    radius = jnp.where(across, x, y)
    ratio = jnp.where(across, y, x) / jnp.where(radius == 0, 1.0, radius)
    angle = jnp.where(across, 0.25 * math.pi * ratio, 0.5 * math.pi - 0.25 * math.pi * ratio)
    return from_components(radius * jnp.cos(angle), radius * jnp.sin(angle))


def uniform_sphere(u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Directions with density 1/(4 pi) (solid angle)."""
    first, second = components(u)
    z = 1.0 - 2.0 * first
    radius, angle = jnp.sqrt(jnp.maximum(1.0 - z * z, 0.0)), 2 * math.pi * second
    return from_components(radius * jnp.cos(angle), radius * jnp.sin(angle), z)


def uniform_sphere_numbers(direction: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
    """The numbers from which `uniform_sphere` draws unit directions."""
    x, y, z = components(direction)
    turns = jnp.arctan2(y, x) / (2 * math.pi)
    return from_components(0.5 * (1.0 - z), turns - jnp.floor(turns))


def uniform_triangle(u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Barycentric coordinates, uniform in area (Heitz 2019, low distortion)."""
    x, y = components(u)
    upper = y > x
    b0 = jnp.where(upper, 0.5 * x, x - 0.5 * y)
    b1 = jnp.where(upper, y - 0.5 * x, 0.5 * y)
    return from_components(b0, b1, 1.0 - b0 - b1)


def uniform_triangle_numbers(barycentric: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
    """The numbers from which `uniform_triangle` draws barycentric coordinates."""
    b0, b1, _ = components(barycentric)
    upper = b1 > b0
    return from_components(jnp.where(upper, 2.0 * b0, b0 + b1), jnp.where(upper, b0 + b1, 2.0 * b1))


def probabilities(
    importance: Float[Array, "*n k"], evenly: Float[Array, "*#n k"] | float = 1.0, floor: float = EVENLY
) -> Float[Array, "*n k"]:
    """Probabilities of k choices in proportion to |importance|, for any values of the parameters it is made of.

    The share `floor` of the choice is in proportion to `evenly` (not negative, not all zero) instead. So a choice whose
    importance is zero now has a derivative too. All of it is where every importance is zero.
    """
    importance = jnp.abs(importance)
    evenly = jnp.broadcast_to(jnp.asarray(evenly, importance.dtype), importance.shape)
    even = evenly / evenly.sum(-1, keepdims=True)
    total = importance.sum(-1, keepdims=True)
    return jnp.where(total > 0, (1.0 - floor) * safe_divide(importance, total) + floor * even, even)


def lobe_probability(first: Float[Array, "*#n"] | float, second: Float[Array, "*#n"] | float) -> Float[Array, "*n"]:
    """Probability of sampling the first of two lobes, in proportion to their |importance|; at least `LEAST` for either.

    So it is a probability for any values of the parameters, and a lobe whose weight is zero now has a derivative too.
    """
    first, second = jnp.abs(first), jnp.abs(second)
    total = first + second
    return jnp.clip(safe_divide(first, total, total > 0, 0.5), LEAST, 1.0 - LEAST)


def choose(
    u: Float[Array, "*#n 2"], probability: Float[Array, "*#n"]
) -> tuple[Bool[Array, "*#n"], Float[Array, "*#n 2"]]:
    """(whether the first of two is chosen, with `probability`; uniform numbers in [0, 1)^2 that are left)."""
    number, other = components(u)
    first = number < probability
    start, width = jnp.where(first, 0.0, probability), jnp.where(first, probability, 1.0 - probability)
    stretched = (number - start) / jnp.where(width > 0, width, 1.0)
    below_one = 1.0 - jnp.finfo(u.dtype).epsneg  # the quotient may round to 1
    return first, from_components(jnp.minimum(stretched, below_one), other)


def linear(u: Float[Array, "*n"], start: Float[Array, "*n"], end: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Numbers in [0, 1] with a density that is linear from `start` at 0 to `end` at 1 (both positive), by inversion."""
    root = jnp.sqrt((1.0 - u) * start * start + u * end * end)
    return jnp.minimum(u * (start + end) / (start + root), 1.0)


def linear_number(t: Float[Array, "*n"], start: Float[Array, "*n"], end: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The number from which `linear` draws `t`."""
    return t * (2.0 * start + t * (end - start)) / (start + end)


def search_sorted_rows(
    cdf: Float[Array, "R K"], row: Int[Array, "*n"], u: Float[Array, "*n"]
) -> tuple[Int[Array, "*n"], Float[Array, "*n"]]:
    """(entries chosen by the cumulative probabilities of these rows, uniform numbers in [0, 1] that are left)."""
    count, flat = cdf.shape[1], cdf.reshape(-1)
    first = row * count

    def halve(_, bounds):
        # The entry is the number of cumulative probabilities that are not above u. It lies in [low, high].
        low, high = bounds
        middle = (low + high) // 2
        above = flat[first + middle] > u
        return jnp.where(above, low, middle + 1), jnp.where(above, middle, high)

    low = jnp.zeros_like(row)
    entry, _ = loops.fori_loop(0, (count - 1).bit_length(), halve, (low, jnp.full_like(row, count - 1)))
    before = jnp.where(entry > 0, flat[first + entry - 1], 0.0)
    width = flat[first + entry] - before
    return entry, jnp.clip((u - before) / jnp.where(width > 0, width, 1.0), 0.0, 1.0)


def number_in_rows(
    cdf: Float[Array, "R K"], row: Int[Array, "*n"], entry: Int[Array, "*n"], left: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """The number for which `search_sorted_rows` chooses `entry` and leaves the number `left`."""
    flat, index = cdf.reshape(-1), row * cdf.shape[1] + entry
    before = jnp.where(entry > 0, flat[index - 1], 0.0)
    return before + left * (flat[index] - before)


def balance(one: Float[Array, "*n"], two: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """one / (one + two), 1 where both are zero: the weight of a strategy by the balance heuristic (Veach 1997)."""
    both = one + two
    return safe_divide(one, both, both > 0, 1.0)
