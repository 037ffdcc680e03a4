"""The threads that share the slices of a query."""

import threading

import pytest

pytest.importorskip("warp")

from jaxdr.geometry.queries.warp import threads


def test_results_are_in_order():
    assert threads.run_all(lambda n: 2 * n, range(1000)) == list(range(0, 2000, 2))
    assert threads.run_all(lambda n: n, []) == []


def test_several_threads_work(monkeypatch):
    """Two calls that wait for each other end only if two threads make them."""
    monkeypatch.setattr(threads, "THREADS", 2)
    meeting = threading.Barrier(2, timeout=20)
    assert sorted(threads.run_all(lambda n: meeting.wait(), range(2))) == [0, 1]


def test_the_thread_that_asks_waits_for_nobody_else(monkeypatch):
    """As in a child process after a fork, which has no other threads."""
    monkeypatch.setattr(threads, "_start", lambda count: None)
    assert threads.run_all(lambda n: n, range(5)) == list(range(5))


def test_an_error_of_a_slice_reaches_the_caller():
    done = []

    def call(n):
        if n == 3:
            raise ValueError("slice 3")
        done.append(n)

    with pytest.raises(ValueError, match="slice 3"):
        threads.run_all(call, range(6))
    assert sorted(done) == [0, 1, 2, 4, 5]
