"""Checkpoints: everything a run needs to go on bit for bit, in one file."""

import zipfile
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int, PyTree

from jaxdr.images import atomic_path


class Checkpoint(NamedTuple):
    """State of a run between two steps.

    - `iteration`: number of steps done.
    - `start`: number of steps done when the topology last changed; the optimiser's own count starts there.
    - `vertices`, `faces`: the mesh at that time, from which the topology is built anew.
    - `latent`: current latent coordinates.
    - `optimizer`: state of the optimiser.
    - `seconds`: time spent so far.
    """

    iteration: int
    start: int
    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    latent: Float[Array, "V 3"]
    optimizer: optax.OptState
    seconds: float


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a `.npz` file that appears complete or not at all, so that an interruption leaves the previous one."""
    arrays = {name: np.asarray(value) for name, value in checkpoint._asdict().items() if name != "optimizer"}
    leaves = {f"optimizer_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(checkpoint.optimizer))}
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, **arrays, **leaves)


def load_checkpoint(path: Path, optimizer: optax.GradientTransformation) -> Checkpoint:
    """Read what `save_checkpoint` wrote. `optimizer` is one of the kind that made the state.

    Raises ValueError when the file is missing, damaged or was written by another optimiser.
    """
    arrays = _arrays(path)
    expected = {*Checkpoint._fields} - {"optimizer"}
    if missing := expected - arrays.keys():
        raise ValueError(f"{path}: is not a checkpoint of this version; it lacks {', '.join(sorted(missing))}")
    latent = jnp.asarray(arrays["latent"])
    initial, structure = jax.tree.flatten(optimizer.init(latent))
    leaves = [arrays.get(f"optimizer_{i}") for i in range(len(initial))]
    if any(leaf is None or leaf.shape != old.shape for leaf, old in zip(leaves, initial, strict=True)):
        raise ValueError(f"{path}: holds the state of another optimiser")
    return Checkpoint(
        iteration=int(arrays["iteration"]),
        start=int(arrays["start"]),
        vertices=arrays["vertices"],
        faces=arrays["faces"],
        latent=latent,
        optimizer=jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in leaves]),
        seconds=float(arrays["seconds"]),
    )


def save_state(path: Path, state: PyTree, iteration: int, seconds: float) -> None:
    """Write the arrays of any state, as `save_checkpoint` does."""
    leaves = {f"state_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(eqx.filter(state, eqx.is_array)))}
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, iteration=iteration, seconds=seconds, **leaves)


def load_state(path: Path, template: PyTree) -> tuple[PyTree, int, float]:
    """(state, iteration, seconds) that `save_state` wrote; `template` is a state of the same structure.

    Raises ValueError when the file is missing, damaged or holds another kind of state.
    """
    arrays = _arrays(path)
    dynamic, static = eqx.partition(template, eqx.is_array)
    old, structure = jax.tree.flatten(dynamic)
    leaves = [arrays.get(f"state_{i}") for i in range(len(old))]
    if any(a is None or (a.shape, a.dtype) != (b.shape, b.dtype) for a, b in zip(leaves, old, strict=True)):
        raise ValueError(f"{path}: holds the state of another optimiser")
    if len(arrays) != len(old) + 2 or not {"iteration", "seconds"} <= arrays.keys():
        raise ValueError(f"{path}: is not a checkpoint of this version")
    state = eqx.combine(jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in leaves]), static)
    return state, int(arrays["iteration"]), float(arrays["seconds"])


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path) as file:
            return dict(file)
    except FileNotFoundError:
        raise ValueError(f"{path}: there is no checkpoint to resume from") from None
    except (OSError, ValueError, zipfile.BadZipFile) as problem:
        raise ValueError(f"{path}: is not a readable checkpoint ({problem})") from None
