"""Warp kernels over whole arrays, which replace NumPy on a GPU: equality of arrays, and the size of their numbers."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def _differ(kept: wp.array(dtype=int), given: wp.array(dtype=int), i: int):
    if i >= kept.shape[0]:
        return False
    return kept[i] != given[i]


@wp.kernel
def find_differences(
    start: int,
    kept_first: wp.array(dtype=int),
    given_first: wp.array(dtype=int),
    kept_second: wp.array(dtype=int),
    given_second: wp.array(dtype=int),
    differ: wp.array(dtype=int),
):
    """Set entries of `differ` if two pairs of arrays of words are not equal bit by bit."""
    i = start + wp.tid()
    if _differ(kept_first, given_first, i):
        differ[0] = 1  # all threads that write here write the same number
    if _differ(kept_second, given_second, i):
        differ[1] = 1


@wp.kernel
def find_largest(start: int, numbers: wp.array(dtype=float), largest: wp.array(dtype=float)):
    """Find the largest absolute value of an array."""
    size = wp.abs(numbers[start + wp.tid()])
    if size > largest[0]:  # true for few threads, so few wait for each other
        wp.atomic_max(largest, 0, size)


@wp.kernel
def count_above(start: int, numbers: wp.array(dtype=int), limit: int, count: wp.array(dtype=int)):
    """Count the numbers that exceed a limit."""
    if numbers[start + wp.tid()] > limit:
        wp.atomic_add(count, 0, 1)
