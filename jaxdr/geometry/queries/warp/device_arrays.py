"""Arrays on a GPU: how a cache of structures compares and copies them, and when structures there may change.

All of it also runs on Warp's CPU device, where it is tested.

Warp (1.19) guarantees little, so two rules follow:

- A callback from JAX works on XLA's stream. Kernels that it launched may still be waiting when it returns. So a lock
  does not tell whether a structure is in use. Before a structure is refitted or dropped, wait for all streams of the
  device.
- Memory is freed in the order of the default stream. This stream waits for streams like Warp's own, but not for XLA's.
  So memory that kernels on XLA's stream still use could be given to other arrays. Therefore structures, and the scratch
  memory of their construction, are made on a stream of Warp's own, and finished before other code sees them.
"""

import contextlib
from collections.abc import Iterator, Sequence

import warp as wp

from jaxdr.geometry.queries.warp import array_kernels as kernels
from jaxdr.geometry.queries.warp.launch import launch


class DeviceArrays:
    """Warp arrays, two pairs of them, compared on their device by one kernel. Two numbers come back to the host."""

    def __init__(self, device):
        self.device = device
        self.stream = None if device.is_cpu else wp.Stream(device)
        self.nothing = wp.empty(0, dtype=int, device=device)
        self.differ = wp.zeros(2, dtype=int, device=device)
        # Pinned memory on the host: a copy to it is started without a detour, and waited for.
        self.answer = self.differ if device.is_cpu else wp.zeros(2, dtype=int, device="cpu", pinned=True)

    def agree(self, kept: Sequence[wp.array], given: Sequence[wp.array]) -> Iterator[bool]:
        """Whether arrays are equal bit by bit, pair by pair; shapes and types are compared first."""
        alike = [a.shape == b.shape and a.dtype == b.dtype for a, b in zip(kept, given, strict=True)]
        if any(alike):
            words = [
                _words(array) if like else self.nothing
                for *pair, like in zip(kept, given, alike, strict=True)
                for array in pair
            ]
            self.differ.zero_()
            launch(kernels.find_differences, max(w.size for w in words), [], [*words, self.differ], self.device)
            if self.answer is not self.differ:
                wp.copy(self.answer, self.differ)
                wp.synchronize_stream(self.device.stream)
        return (like and not found for like, found in zip(alike, self.answer.numpy().tolist(), strict=True))

    def copies(self, given: Sequence[wp.array]) -> list[wp.array]:
        """Copies that no other code writes to."""
        return [wp.clone(a) for a in given]

    @contextlib.contextmanager
    def changes(self) -> Iterator[None]:
        """A context that first waits for all kernels on the device, and in the end for kernels launched inside.

        Copies may be made inside: their sources are complete when it begins.
        """
        if self.stream is None:
            yield
            return
        wp.synchronize_device(self.device)
        with wp.ScopedStream(self.stream, sync_enter=False):
            try:
                yield
            finally:
                wp.synchronize_stream(self.stream)


def largest(array: wp.array) -> float:
    """The largest absolute value in an array of float vectors; waits for the device."""
    numbers = _as(array, float)
    found = wp.zeros(1, dtype=float, device=array.device)
    # In one slice: on a CPU the maximum is not atomic between threads.
    launch(kernels.find_largest, numbers.size, [], [numbers, found], array.device, each=max(1, numbers.size))
    return float(found.numpy()[0])


def number_above(array: wp.array, limit: int) -> int:
    """How many whole numbers exceed a limit; waits for the device."""
    count = wp.zeros(1, dtype=int, device=array.device)
    launch(kernels.count_above, array.size, [], [array, limit, count], array.device, each=max(1, array.size))
    return int(count.numpy()[0])


def _words(array: wp.array) -> wp.array:
    """The same memory as words of 32 bits."""
    return _as(array, int)


def _as(array: wp.array, dtype) -> wp.array:
    size = array.size * wp.types.type_size_in_bytes(array.dtype) // 4
    return wp.array(ptr=array.ptr, dtype=dtype, shape=size, device=array.device)
