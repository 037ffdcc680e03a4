"""Warp kernels over whole arrays, in place of NumPy on a GPU: whether two are equal, how large their numbers are."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def find_difference(
    start: int, kept: wp.array(dtype=int), given: wp.array(dtype=int), pair: int, differ: wp.array(dtype=int)
):
    """Set number `pair` of `differ` where two arrays of words are not equal bit by bit."""
    i = start + wp.tid()
    if kept[i] != given[i]:
        differ[pair] = 1  # all that write here write the same


@wp.kernel
def find_largest(start: int, numbers: wp.array(dtype=float), largest: wp.array(dtype=float)):
    """The largest absolute value."""
    size = wp.abs(numbers[start + wp.tid()])
    if size > largest[0]:  # few are, so few wait for each other
        wp.atomic_max(largest, 0, size)


@wp.kernel
def count_above(start: int, numbers: wp.array(dtype=int), limit: int, count: wp.array(dtype=int)):
    """How many numbers exceed a limit."""
    if numbers[start + wp.tid()] > limit:
        wp.atomic_add(count, 0, 1)
