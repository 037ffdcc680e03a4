"""Checkpoints: everything a run needs to go on bit for bit, in one file."""

import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from jaxdr.images import atomic_path

STATE = "state_"


class Checkpoint(NamedTuple):
    """State of a run after `iteration` steps and `seconds`: arrays of its `leaves`, and `others` by name."""

    path: Path
    iteration: int
    seconds: float
    leaves: dict[str, np.ndarray]
    others: dict[str, np.ndarray]

    def state(self, template: PyTree) -> PyTree:
        """The state; `template` is one of the same structure. Raises ValueError where this holds another kind."""
        dynamic, static = eqx.partition(template, eqx.is_array)
        old, structure = jax.tree.flatten(dynamic)
        new = [self.leaves.get(f"{STATE}{i}") for i in range(len(old))]
        alike = all(a is not None and (a.shape, a.dtype) == (b.shape, b.dtype) for a, b in zip(new, old, strict=True))
        if not alike or len(self.leaves) != len(old):
            raise ValueError(f"{self.path}: holds the state of another optimiser")
        return eqx.combine(jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in new]), static)


def save_checkpoint(path: Path, state: PyTree, iteration: int, seconds: float, **others: Any) -> None:
    """Write a `.npz` file that appears complete or not at all, so that an interruption leaves the previous one."""
    arrays = jax.tree.leaves(eqx.filter(state, eqx.is_array))
    leaves = {f"{STATE}{i}": np.asarray(leaf) for i, leaf in enumerate(arrays)}
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, iteration=iteration, seconds=seconds, **others, **leaves)


def load_checkpoint(path: Path, *others: str) -> Checkpoint:
    """What `save_checkpoint` wrote, with these `others`. Raises ValueError when it is missing, damaged or another's."""
    try:
        with np.load(path) as file:
            arrays = dict(file)
    except FileNotFoundError:
        raise ValueError(f"{path}: there is no checkpoint to resume from") from None
    except (OSError, ValueError, zipfile.BadZipFile) as problem:
        raise ValueError(f"{path}: is not a readable checkpoint ({problem})") from None
    leaves = {name: arrays.pop(name) for name in list(arrays) if name.startswith(STATE)}
    if missing := {"iteration", "seconds", *others} - arrays.keys():
        raise ValueError(f"{path}: is not a checkpoint of this version; it lacks {', '.join(sorted(missing))}")
    iteration, seconds = int(arrays.pop("iteration")), float(arrays.pop("seconds"))
    return Checkpoint(path, iteration, seconds, leaves, arrays)
