"""Checkpoints: everything a run needs to go on bit for bit, in one file."""

import zipfile
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

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
    try:
        with np.load(path) as file:
            arrays = dict(file)
    except FileNotFoundError:
        raise ValueError(f"{path}: there is no checkpoint to resume from") from None
    except (OSError, ValueError, zipfile.BadZipFile) as problem:
        raise ValueError(f"{path}: is not a readable checkpoint ({problem})") from None
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
