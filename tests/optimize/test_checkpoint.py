"""Checkpoints: one format, leaves by name, bit for bit, and an error of its own for each thing that can be wrong."""

import json
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.optimize.checkpoint import Owner, Place, load_checkpoint, named_leaves, save_checkpoint

OWNER = Owner("shape optimisation", {"seed": 0, "levels": [{"steps": 3}]})


class Moments(NamedTuple):
    count: jax.Array
    mu: dict


def state(size: int = 4):
    values = jax.random.normal(jax.random.key(0), (size, 3))
    return {"latent": values, "optimizer": (Moments(jnp.asarray(7, jnp.int32), {"lamp.radiance": values / 3}), None)}


@pytest.fixture
def path(tmp_path):
    place = Place(5, 1.5, 2, 4, 3, np.ones((4, 3), np.float32), np.array([[0, 1, 2]]))
    save_checkpoint(tmp_path / "checkpoint.npz", OWNER, place, state())
    return tmp_path / "checkpoint.npz"


def changed(path, **values):
    with np.load(path) as file:
        arrays = {**file, **values}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})


def test_everything_comes_back_bit_for_bit_and_by_name(path):
    found = load_checkpoint(path, OWNER)
    assert tuple(found.place)[:5] == (5, 1.5, 2, 4, 3)
    assert found.place.vertices.dtype == np.float32 and found.place.faces.tolist() == [[0, 1, 2]]
    assert list(found.leaves) == ["latent", "optimizer/0/count", "optimizer/0/mu/lamp.radiance"]
    back = found.state(jax.tree.map(jnp.zeros_like, state()))
    assert jax.tree.structure(back) == jax.tree.structure(state())
    for one, other in zip(jax.tree.leaves(back), jax.tree.leaves(state()), strict=True):
        assert one.dtype == other.dtype and one.tobytes() == other.tobytes()


def test_arrays_of_many_devices_are_whole_in_the_file(path):
    mesh = jax.make_mesh((1,), ("views",), axis_types=(jax.sharding.AxisType.Auto,))
    sharded = jax.device_put(state(), jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec()))
    for name, leaf in named_leaves(sharded).items():
        np.testing.assert_array_equal(leaf, named_leaves(state())[name])


def damaged(path):
    path.write_bytes(path.read_bytes()[:-30])


def empty(path):
    path.write_bytes(b"")


def flipped(path):
    data = bytearray(path.read_bytes())
    data[data.index(b"state/latent.npy") + 160] ^= 1  # in the values: the sum of the archive tells
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    "harm, words",
    [
        (lambda path: path.unlink(), "there is no checkpoint to resume from"),
        (damaged, "is damaged, it is not a readable checkpoint"),
        (empty, "is damaged, it is not a readable checkpoint"),
        (flipped, "is damaged, it is not a readable checkpoint"),
        (lambda path: path.write_text("notes"), "is damaged, it is not a readable checkpoint"),
        (lambda path: changed(path, faces=None), "is damaged: it lacks faces"),
        (lambda path: changed(path, version=1), "of another version (its format is 1, this jaxdr reads 2)"),
        (lambda path: changed(path, version=None, iteration=3), "of another version (its format is 1"),
        (lambda path: changed(path, kind="recovery"), "of a recovery, this is a shape optimisation"),
        (
            lambda path: changed(path, config=json.dumps({"seed": 1})),
            "another config: seed was 1, is 0; levels was",
        ),
    ],
    ids=["missing", "cut", "empty", "flipped", "text", "lacks", "newer", "older", "kind", "config"],
)
def test_one_clear_error_each(path, harm, words):
    harm(path)
    with pytest.raises(ValueError) as caught:
        load_checkpoint(path, OWNER)
    message = str(caught.value)
    assert message.startswith(str(path)) and words in message and "\n" not in message


def test_another_state_is_refused_by_the_name_of_its_leaf(path):
    found = load_checkpoint(path, OWNER)
    with pytest.raises(ValueError, match=r"latent is float32\[4, 3\], expected float32\[5, 3\]"):
        found.state(state(5))
    with pytest.raises(ValueError, match=r"optimizer/0/count is int32\[\], expected absent"):
        found.state({"latent": state()["latent"]})
    with pytest.raises(ValueError, match=r"sky is absent, expected float32\[2\]"):
        found.state({**state(), "sky": jnp.zeros(2)})
