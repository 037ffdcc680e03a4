"""The cache of acceleration structures: found by content, bounded, refitted only so often.

With arrays on the host, and with arrays as they are on a GPU (here on Warp's CPU device).
"""

import contextlib
import gc

import numpy as np
import pytest
import warp as wp

from jaxdr.geometry.queries.bvh_cache import BVHCache, HostArrays
from jaxdr.geometry.queries.warp.device_arrays import DeviceArrays, largest, number_above


class Structure:
    """Remembers what it was built from and how often it was refitted."""

    def __init__(self, moving, topology):
        self.moving, self.topology, self.refits = moving, topology, 0

    def refit(self, moving):
        self.moving, self.refits = moving, self.refits + 1


class Cache:
    """A cache that is asked with NumPy arrays, whatever arrays it keeps."""

    def __init__(self, arrays, **options):
        self.cache = BVHCache(Structure, Structure.refit, arrays, **options)
        self.on_host = isinstance(arrays, HostArrays)

    def find(self, *groups):
        return self.cache.find(*(groups if self.on_host else [[on_device(a) for a in group] for group in groups]))

    @property
    def entries(self):
        return self.cache.entries


def on_device(array):
    dtype = {"f": wp.vec3, "i": wp.vec3i}[array.dtype.kind]
    return wp.array(array, dtype=dtype, device="cpu", copy=False)


@pytest.fixture(params=["host", "device"])
def make(request):
    """A cache of either kind."""
    arrays = HostArrays() if request.param == "host" else DeviceArrays(wp.get_device("cpu"))
    return lambda **options: Cache(arrays, **options)


def points(value, count=4):
    return np.full((count, 3), value, np.float32)


FACES, OTHER_FACES = np.array([[0, 1, 2]], np.int32), np.array([[0, 2, 1]], np.int32)


def test_equal_content_finds_the_same_structure(make):
    cache = make()
    first = cache.find([points(1)], [FACES])
    assert cache.find([points(1).copy()], [FACES.copy()]) is first
    assert cache.find([points(2)], [FACES]) is not first
    assert cache.find([points(1)], [OTHER_FACES]) is not first
    assert cache.find([points(1, 5)], [FACES]) is not first
    assert cache.find([points(1)], [FACES]) is first


def test_the_last_bit_counts(make):
    cache = make()
    first = cache.find([points(1)], [FACES])
    moved = points(1)
    moved[3, 2] = np.nextafter(np.float32(1), np.float32(2))
    assert cache.find([moved], [FACES]) is not first
    zero = cache.find([points(0)], [FACES])
    assert cache.find([points(-0.0)], [FACES]) is not zero
    # Not a number equals itself here.
    nan = cache.find([points(np.nan)], [FACES])
    assert cache.find([points(np.nan)], [FACES]) is nan


def test_the_cache_keeps_copies(make):
    """Changing an array in place after a query must not change what the cache knows."""
    cache = make()
    array = points(1)
    first = cache.find([array], [FACES])
    array += 1
    assert cache.find([array], [FACES]) is not first
    assert cache.find([points(1)], [FACES]) is first


def test_refits_the_oldest_of_a_topology_and_rebuilds_in_the_end(make):
    cache = make(per_topology=2, max_refits=3)
    a, b = cache.find([points(1)], [FACES]), cache.find([points(2)], [FACES])
    assert cache.find([points(3)], [FACES]) is a and a.refits == 1
    np.testing.assert_array_equal(np.asarray(a.moving[0]), points(3))
    assert cache.find([points(4)], [FACES]) is b
    assert cache.find([points(4)], [FACES]) is b and b.refits == 1
    found = [cache.find([points(k)], [FACES]) for k in range(5, 11)]
    assert a.refits == b.refits == 3
    assert found[-1] is not a and found[-1] is not b and found[-1].refits == 0
    assert len(cache.entries) == 2


def test_another_number_of_points_is_never_refitted(make):
    """The same faces over more vertices."""
    cache = make(per_topology=1)
    first = cache.find([points(1)], [FACES])
    assert cache.find([points(1, 5)], [FACES]) is not first
    assert first.refits == 0 and len(cache.entries) == 1


def test_capacity_evicts_the_least_recently_used(make):
    cache = make(capacity=3)
    topologies = [np.array([[0, 1, k]], np.int32) for k in range(4)]
    found = [cache.find([points(1)], [topologies[k]]) for k in range(3)]
    assert cache.find([points(1)], [topologies[0]]) is found[0]
    cache.find([points(1)], [topologies[3]])  # evicts number 1
    assert len(cache.entries) == 3
    assert cache.find([points(1)], [topologies[0]]) is found[0]
    assert cache.find([points(1)], [topologies[2]]) is found[2]
    assert cache.find([points(1)], [topologies[1]]) is not found[1]


def test_another_type_is_another_content(make):
    """The same bits as whole numbers and as real ones."""
    cache = make()
    first = cache.find([points(0)], [FACES])
    assert cache.find([np.zeros((4, 3), np.int32)], [FACES]) is not first


def test_structures_change_only_while_nobody_uses_them():
    """Whatever is built, refitted or dropped is so within `changes`, and a query that finds its structure waits not."""
    log = []

    class Watched(Structure):
        def __init__(self, moving, topology):
            super().__init__(moving, topology)
            log.append("build")

        def refit(self, moving):
            super().refit(moving)
            log.append("refit")

        def __del__(self):
            log.append("drop")

    class Arrays(HostArrays):
        @contextlib.contextmanager
        def changes(self):
            log.append("(")
            yield
            log.append(")")

    cache = BVHCache(Watched, Watched.refit, Arrays(), capacity=2, per_topology=1, max_refits=1)

    def events(value, faces):
        log.clear()
        cache.find([points(value)], [faces])
        return log.copy()

    gc.disable()  # nothing may wait for it
    try:
        assert events(1, FACES) == ["(", "build", ")"]
        assert events(1, FACES) == []
        assert events(2, FACES) == ["(", "refit", ")"]
        assert events(3, FACES) == ["(", "drop", "build", ")"]
        assert events(1, OTHER_FACES) == ["(", "build", ")"]
        assert events(1, FACES[:, ::-1].copy()) == ["(", "drop", "build", ")"]
        assert len(cache.entries) == 2
    finally:
        gc.enable()


def test_a_structure_that_can_not_be_refitted_is_forgotten():
    """An error in the middle of a refit must not leave an entry with new content and an old structure."""

    def fail(structure, moving):
        raise MemoryError

    cache = BVHCache(Structure, fail, per_topology=1)
    first = cache.find([points(1)], [FACES])
    with pytest.raises(MemoryError):
        cache.find([points(2)], [FACES])
    again = cache.find([points(2)], [FACES])
    assert again is not first and again.moving[0][0, 0] == 2


def test_numbers_of_arrays_on_a_device():
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=(30_000, 3)).astype(np.float32)
    numbers[12_345, 1] = -9.5
    assert largest(on_device(numbers)) == 9.5
    counts = wp.array(rng.integers(0, 10, 30_000), dtype=int, device="cpu")
    assert number_above(counts, 6) == np.count_nonzero(counts.numpy() > 6)
    assert number_above(counts[:0], 6) == 0
