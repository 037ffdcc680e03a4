"""The cache of acceleration structures: found by content, bounded, refitted only so often."""

import numpy as np

from jaxdr.geometry.queries.bvh_cache import BVHCache


class Structure:
    """Remembers what it was built from and how often it was refitted."""

    def __init__(self, moving, topology):
        self.moving, self.topology, self.refits = moving, topology, 0

    def refit(self, moving):
        self.moving, self.refits = moving, self.refits + 1


def make(**options) -> BVHCache:
    return BVHCache(Structure, Structure.refit, **options)


def points(value, count=4):
    return np.full((count, 3), value, np.float32)


FACES, OTHER_FACES = np.array([[0, 1, 2]], np.int32), np.array([[0, 2, 1]], np.int32)


def test_equal_content_finds_the_same_structure():
    cache = make()
    first = cache.find([points(1)], [FACES])
    assert cache.find([points(1).copy()], [FACES.copy()]) is first
    assert cache.find([points(2)], [FACES]) is not first
    assert cache.find([points(1)], [OTHER_FACES]) is not first
    assert cache.find([points(1, 5)], [FACES]) is not first
    assert cache.find([points(1)], [FACES]) is first


def test_the_last_bit_counts():
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


def test_the_cache_keeps_copies():
    """Changing an array in place after a query must not change what the cache knows."""
    cache = make()
    array = points(1)
    first = cache.find([array], [FACES])
    array += 1
    assert cache.find([array], [FACES]) is not first
    assert cache.find([points(1)], [FACES]) is first


def test_refits_the_oldest_of_a_topology_and_rebuilds_in_the_end():
    cache = make(per_topology=2, max_refits=3)
    a, b = cache.find([points(1)], [FACES]), cache.find([points(2)], [FACES])
    assert cache.find([points(3)], [FACES]) is a and a.refits == 1
    np.testing.assert_array_equal(a.moving[0], points(3))
    assert cache.find([points(4)], [FACES]) is b
    assert cache.find([points(4)], [FACES]) is b and b.refits == 1
    found = [cache.find([points(k)], [FACES]) for k in range(5, 11)]
    assert a.refits == b.refits == 3
    assert found[-1] is not a and found[-1] is not b and found[-1].refits == 0
    assert len(cache.entries) == 2


def test_another_number_of_points_is_never_refitted():
    """The same faces over more vertices."""
    cache = make(per_topology=1)
    first = cache.find([points(1)], [FACES])
    assert cache.find([points(1, 5)], [FACES]) is not first
    assert first.refits == 0 and len(cache.entries) == 1


def test_capacity_evicts_the_least_recently_used():
    cache = make(capacity=3)
    topologies = [np.array([[0, 1, k]], np.int32) for k in range(4)]
    found = [cache.find([points(1)], [topologies[k]]) for k in range(3)]
    assert cache.find([points(1)], [topologies[0]]) is found[0]
    cache.find([points(1)], [topologies[3]])  # evicts number 1
    assert len(cache.entries) == 3
    assert cache.find([points(1)], [topologies[0]]) is found[0]
    assert cache.find([points(1)], [topologies[2]]) is found[2]
    assert cache.find([points(1)], [topologies[1]]) is not found[1]
