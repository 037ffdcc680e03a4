"""How many rows programs work on at once: by the device that JAX takes, unless the caller says otherwise."""

import jax
import pytest

import jaxdr as jd
from jaxdr import sizes


@pytest.fixture
def on_gpu(monkeypatch):
    monkeypatch.setattr(sizes, "platform", lambda: "gpu")


def test_platform_is_that_of_the_default_device():
    assert sizes.platform() == jax.default_backend()
    with jax.default_device("tpu"):
        assert sizes.platform() == "tpu"
    with jax.default_device(jax.devices()[0]):
        assert sizes.platform() == jax.devices()[0].platform


def test_chunks_on_a_cpu(monkeypatch):
    monkeypatch.setattr(sizes, "platform", lambda: "cpu")
    assert jd.PathTracer().paths_at_once(True) == 65_536
    assert jd.PathTracer().paths_at_once(False) == 4 * 65_536
    assert jd.BidirectionalPathTracer(2).paths_at_once(True) == 131_072  # two connections for every path


def test_chunks_on_a_gpu(on_gpu):
    assert jd.PathTracer().paths_at_once(True) == 1_048_576
    assert jd.BidirectionalPathTracer(2).paths_at_once(True) == 1_048_576


def test_a_size_that_is_given_counts(on_gpu):
    assert jd.PathTracer(chunk_size=100).paths_at_once(True) == 100
    assert jd.BidirectionalPathTracer(2, chunk_size=100).paths_at_once(True) == 50
