"""Parameters that a scene file says are one: shapes whose BSDF, texture or emitter is the same object of the file."""

from collections.abc import Collection, Iterable
from operator import attrgetter
from typing import NamedTuple

import equinox as eqx
import numpy as np

from jaxdr.scene.bsdf import TwoSided
from jaxdr.scene.scene import Scene, float_fields


class Made(NamedTuple):
    """What a reader has made of an object of a file: one module, or one for each mesh.

    Its parameters are called `<name><kind>.<field>`.
    """

    name: str
    kind: str
    modules: list[eqx.Module]


class _Tie(NamedTuple):
    owner: Made
    field: str
    members: tuple[str, ...]


def tie_shared(scene: Scene, made: Iterable[Made]) -> Scene:
    """The scene with ties between parameters that stand for one number of its file.

    These hold arrays of one object of the file, and have the same value. Parameters inside of several objects are named
    by the innermost one. A name with which one of its parameters would be called as another one gets a number.
    """
    owners: dict[int, list[str]] = {}
    parameters = scene.parameters()
    for name, array in parameters.items():
        owners.setdefault(id(array), []).append(name)
    # The innermost object of a parameter has the shortest name for it.
    found = sorted((tie for owner in made for tie in _possible(owner, owners)), key=lambda tie: tie.field.count("."))
    ties: list[_Tie] = []
    tied: set[str] = set()
    for tie in found:
        if tied.isdisjoint(tie.members):
            tied.update(tie.members)
            ties.append(tie)
    named: dict[str, tuple[str, ...]] = {}
    for owner in {id(tie.owner): tie.owner for tie in ties}.values():
        members = {f"{owner.kind}.{tie.field}": tie.members for tie in ties if tie.owner is owner}
        name = _free(owner.name, members, {*parameters, *named})
        named.update({name + end: value for end, value in members.items()})
    return scene.tie(named)


def _possible(made: Made, owners: dict[int, list[str]]) -> list[_Tie]:
    """Parameters of a scene that hold the same field of an object. `owners`: parameters by ids of arrays."""
    modules = [module.bsdf if isinstance(module, TwoSided) else module for module in made.modules]
    first, *others = [float_fields(module) for module in modules]
    found = []
    for field in (field for field in first if all(field in other for other in others)):
        arrays = [attrgetter(field)(module) for module in modules]
        members = tuple(sorted({name for array in arrays for name in owners.get(id(array), ())}))
        if len(members) > 1 and all(_same(array, arrays[0]) for array in arrays):
            found.append(_Tie(made, field, members))
    return found


def _same(one, other) -> bool:
    return one.dtype == other.dtype and np.array_equal(one, other)


def _free(name: str, ends: Iterable[str], taken: Collection[str]) -> str:
    """The name, with a number if one of `taken` is that name and one of these ends."""
    names = (f"{name}_{i}" if i else name for i in range(len(taken) + 1))
    return next(name for name in names if not any(name + end in taken for end in ends))
