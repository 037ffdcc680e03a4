"""Running Warp kernels: batches are sliced over threads on CPUs and whole on CUDA; lists of results of unknown length.

Every kernel works on the slice that starts at its argument `start`, so that a CPU launch can be split over threads.
"""

import warnings

import numpy as np
import warp as wp

from jaxdr.geometry.queries.warp.threads import run_all
from jaxdr.quiet_warp import load_module

# Rays in a slice. The number is fixed, so that results have the same order with any number of threads.
SLICE = 8192


def launch(kernel, count: int, leading: list, rest: list, device, each: int = SLICE) -> None:
    """Run `kernel(*leading, start, *rest)` over `count` rays or numbers, `each` at a time."""
    if count == 0:
        return
    load_module(kernel, device)
    if not device.is_cpu:
        wp.launch(kernel, dim=count, inputs=[*leading, 0, *rest], device=device, record_tape=False)
        return

    def run(start):
        size = min(each, count - start)
        wp.launch(kernel, dim=size, inputs=[*leading, start, *rest], device=device, record_tape=False)

    run_all(run, range(0, count, each))


SILHOUETTES = (
    "the silhouettes of {total} segments or chords exceed the capacity of {capacity} and were thinned without bias. "
    "{enough} times the capacity, or a smaller reach, avoids it."
)


def compact(kernel, leading: list, rest: list, total: int, lists: list, counts: int, device, too_many=SILHOUETTES):
    """Run a kernel that appends rows to `lists`, and thin the rows without bias if there are more than fit.

    The kernel's arguments are `(*leading, start, *rest, probability, *lists, found)`. It adds to `found`, an array of
    `counts` whole numbers: the rows it kept, all rows, and other counts. The first list holds row numbers, -1 in unused
    slots. On a GPU the host waits for `found`, because the host decides whether to thin and to warn. The probability of
    a row to survive depends on the number of rows only. So weighting the survivors by its inverse is unbiased. Eight
    standard deviations of slack keep them within the capacity. Then `too_many` is a warning. Returns (found, 1 /
    probability).
    """
    capacity, probability = lists[0].shape[0], 1.0
    found = _run(kernel, leading, rest, total, probability, lists, counts, device)
    if found[0] > capacity:
        every = int(found[1])
        probability = max(capacity - 8.0 * capacity**0.5, 0.5 * capacity) / every
        # Round to a power of two. The exact number differs from call to call, and Python shows each new text again.
        enough = 1 << (every // capacity).bit_length()
        warnings.warn(f"jaxdr: {too_many.format(total=total, capacity=capacity, enough=enough)}", stacklevel=2)
        kept = _run(kernel, leading, rest, total, probability, lists, counts, device)[0]
        if kept > capacity:
            raise RuntimeError(f"jaxdr: thinning {every} pairs left {kept}, more than the capacity of {capacity}")
    return found, 1.0 / probability


def _run(kernel, leading, rest, total, probability, lists, counts, device) -> np.ndarray:
    capacity = lists[0].shape[0]
    lists[0].fill_(-1)
    for table in lists[1:]:
        table.zero_()
    load_module(kernel, device)
    if not device.is_cpu:
        found = wp.zeros(counts, dtype=int, device=device)
        inputs = [*leading, 0, *rest, probability, *lists, found]
        wp.launch(kernel, dim=total, inputs=inputs, device=device, record_tape=False)
        return found.numpy()

    def run(start):
        size = min(SLICE, total - start)
        out = [wp.empty(capacity, dtype=table.dtype, device=device) for table in lists]
        found = wp.zeros(counts, dtype=int, device=device)
        inputs = [*leading, start, *rest, probability, *out, found]
        wp.launch(kernel, dim=size, inputs=inputs, device=device, record_tape=False)
        kept = min(int(found.numpy()[0]), capacity)
        return [a.numpy()[:kept] for a in out], found.numpy()

    # Each slice fills its own lists, which are joined in order. So the result does not depend on timing.
    parts = run_all(run, range(0, total, SLICE))
    for index, target in enumerate(lists):
        joined = np.concatenate([part[0][index] for part in parts])[:capacity] if parts else np.zeros(0)
        target.numpy()[: len(joined)] = joined
    return sum((part[1] for part in parts), np.zeros(counts, np.int64))
