"""Checkpoints: everything a run needs to go on bit for bit, in one file, the same for all kinds of runs.

A checkpoint is an `.npz` of NumPy: one file that one rename replaces, of whole arrays on the host, so that a run may go
on with another number of devices. Orbax (0.12) was looked at: it writes a folder (12 files for four arrays), deletes
the old checkpoint before it writes a new one of the same name, and brings 15 packages of 108 MB. It pays where arrays
are too large for one host; those of a run are a few numbers a vertex.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PyTree

from jaxdr.atomic_file import atomic_path
from jaxdr.untrusted import arrays_of, damage, finite, json_of, whole

VERSION = 2  # 1 had no names of leaves, and said neither its version nor whose it was
STATE = "state/"
PLACE = ("step", "seconds", "level", "since", "start", "vertices", "faces")


class Owner(NamedTuple):
    """The run that a checkpoint belongs to: its `kind`, and what of its `config` decides the result, as JSON."""

    kind: str
    config: dict


class Place(NamedTuple):
    """Where a run is: after `step` steps and `seconds`.

    - `level`: its level, which began after `since` steps.
    - `vertices`, `faces`: the mesh as it was when its topology last changed, after `start` steps; empty without one.
    """

    step: int
    seconds: float
    level: int = 0
    since: int = 0
    start: int = 0
    vertices: Float[np.ndarray, "V 3"] = np.zeros((0, 3))
    faces: Int[np.ndarray, "F 3"] = np.zeros((0, 3), np.int64)


class Checkpoint(NamedTuple):
    """What `load_checkpoint` found: where the run was, and the arrays of its state by their paths in the pytree."""

    path: Path
    place: Place
    leaves: dict[str, np.ndarray]

    def state(self, template: PyTree) -> PyTree:
        """The state; `template` is one of the same structure. Raises ValueError that names a leaf that differs."""
        dynamic, static = eqx.partition(template, eqx.is_array)
        expected = named_leaves(dynamic)
        for name in dict.fromkeys([*expected, *self.leaves]):
            found, wanted = (_shape(leaves.get(name)) for leaves in (self.leaves, expected))
            if found != wanted:
                raise ValueError(
                    f"{self.path}: holds the state of another optimiser: {name} is {found}, expected {wanted}; "
                    "start again with --overwrite"
                )
        structure = jax.tree.structure(dynamic)
        leaves = [jnp.asarray(self.leaves[name]) for name in expected]
        return eqx.combine(jax.tree.unflatten(structure, leaves), static)


def named_leaves(state: PyTree) -> dict[str, np.ndarray]:
    """The arrays of a pytree on the host, in its order, by their paths: `optimizer/0/mu/vertices`."""
    found = jax.tree_util.tree_leaves_with_path(eqx.filter(state, eqx.is_array))
    named = {jax.tree_util.keystr(path, simple=True, separator="/"): np.asarray(leaf) for path, leaf in found}
    assert len(named) == len(found), "two leaves have one name"
    return named


def save_checkpoint(path: Path, owner: Owner, place: Place, state: PyTree) -> None:
    """Write a file that appears complete or not at all, so that an interruption leaves the previous one.

    Raises `CannotWrite`.
    """
    leaves = {STATE + name: leaf for name, leaf in named_leaves(state).items()}
    head = {"version": VERSION, "kind": owner.kind, "config": json.dumps(owner.config)}
    arrays: dict[str, Any] = {**head, **place._asdict(), **leaves}
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, **arrays)


def load_checkpoint(path: Path, owner: Owner) -> Checkpoint:
    """What `save_checkpoint` wrote.

    Raises ValueError, each with words of its own, for a file that is missing, damaged, of another version, of another
    kind of run, or of a run with another config.
    """
    arrays = _arrays(path)
    if "version" not in arrays or arrays["version"] != VERSION:
        found = arrays["version"] if "version" in arrays else 1 if "iteration" in arrays else "none of ours"
        raise ValueError(
            f"{path}: is a checkpoint of another version (its format is {found}, this jaxdr reads {VERSION}); go on "
            "with the jaxdr that wrote it, or start again with --overwrite"
        )
    if missing := {"kind", "config", *PLACE} - arrays.keys():
        raise ValueError(f"{path}: is damaged: it lacks {', '.join(sorted(missing))}; start again with --overwrite")
    kind, config = str(arrays["kind"]), json_of(str(arrays["config"]), f"{path}: config")
    if kind != owner.kind:
        raise ValueError(f"{path}: is the checkpoint of a {kind}, this is a {owner.kind}; choose another output")
    if changed := differences(config, owner.config):
        raise ValueError(
            f"{path}: is the checkpoint of a run with another config: {'; '.join(changed)}; take that config, or "
            "start again with --overwrite"
        )
    with damage(f"{path}: is damaged; start again with --overwrite"):
        step, level, since, start = (
            whole(arrays[name].item(), name, high=2**31) for name in ("step", "level", "since", "start")
        )
        seconds = finite(arrays["seconds"].item(), "seconds", low=0.0)
        place = Place(step, seconds, level, since, start, arrays["vertices"], arrays["faces"])
    leaves = {name.removeprefix(STATE): leaf for name, leaf in arrays.items() if name.startswith(STATE)}
    return Checkpoint(path, place, leaves)


def differences(old: Any, new: Any, key: str = "") -> list[str]:
    """The differences of two configs, given as JSON, in words: "seed was 0, is 1"."""
    if isinstance(old, dict) and isinstance(new, dict):
        names = dict.fromkeys([*old, *new])
        return [d for n in names for d in differences(old.get(n), new.get(n), f"{key}.{n}" if key else n)]
    return [] if old == new else [f"{key} was {old!r}, is {new!r}"]


def _arrays(path: Path) -> dict[str, np.ndarray]:
    if not path.exists():
        raise ValueError(f"{path}: there is no checkpoint to resume from; start again with --overwrite")
    try:
        return arrays_of(path, f"{path}: is damaged, it is not a readable checkpoint")
    except ValueError as problem:
        raise ValueError(f"{problem}; start again with --overwrite") from None


def _shape(leaf: np.ndarray | None) -> str:
    return "absent" if leaf is None else f"{leaf.dtype}{list(leaf.shape)}"
