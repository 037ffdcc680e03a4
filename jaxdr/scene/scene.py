"""Scene: shapes, camera, environment and lights as one pytree with named parameters."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_array
from jaxdr.geometry.mesh import Mesh
from jaxdr.scene.bsdf import BSDF, Diffuse, TwoSided
from jaxdr.scene.camera import Camera
from jaxdr.scene.emitters import AreaEmitter, Environment
from jaxdr.scene.lights import DeltaLight
from jaxdr.scene.ranges import check_parameter
from jaxdr.scene.summary import scene_html
from jaxdr.scene.textures import Texture, textures_in

RESERVED = ("camera", "environment")


@checked
class Shape(eqx.Module):
    """A mesh with its material and, if it glows, its emitter.

    - `mesh`: a `Mesh`.
    - `bsdf`: how the surface scatters light; by default grey `Diffuse`.
    - `emitter`: an `AreaEmitter`, or None.

    Raises ValueError if one of them is of another type.
    """

    mesh: Mesh
    bsdf: BSDF | TwoSided = eqx.field(default_factory=Diffuse)
    emitter: AreaEmitter | None = None


def _sorted_by_id(members: Mapping) -> dict:
    # JAX sorts dictionaries when it flattens them: sorting here keeps the order the same before and after.
    return dict(sorted(members.items()))


@checked
class Scene(eqx.Module):
    """Shapes, a camera and lights: what `render` draws.

    - `shapes`: `Shape`s by id; at least one.
    - `camera`: a `Perspective`, `ThinLens` or `Orthographic`, with its film.
    - `environment`: light from infinitely far away, or None for black.
    - `lights`: lights without area, by id.
    - `tied`: pairs (name, names of parameters that it stands for), see `tie`. Loaders tie what a file shares.

    Names of `parameters` begin with an id. Raises ValueError for a scene without shapes, for an id that is empty, has a
    dot, is `camera` or `environment`, or names both a shape and a light, and for textures that do not fit the mesh of
    their shape.
    """

    shapes: dict[str, Shape] = eqx.field(converter=_sorted_by_id)
    camera: Camera
    environment: Environment | None = None
    lights: dict[str, DeltaLight] = eqx.field(converter=_sorted_by_id, default_factory=dict)
    tied: tuple[tuple[str, tuple[str, ...]], ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        if not self.shapes:
            raise ValueError("Scene: shapes is empty; a scene needs at least one shape")
        for kind, members, expected in (("shape", self.shapes, Shape), ("light", self.lights, DeltaLight)):
            for name, member in members.items():
                if not name or "." in name or name in RESERVED:
                    raise ValueError(
                        f"Scene: {name!r} can't be a {kind} id (no dots, not empty, not {' or '.join(RESERVED)})"
                    )
                if not isinstance(member, expected):
                    raise ValueError(
                        f"Scene: {kind}s[{name!r}] is a {type(member).__name__}, expected a jaxdr.{expected.__name__}"
                    )
        for name in self.lights:
            if name in self.shapes:
                raise ValueError(f"Scene: {name!r} is the id of a shape and of a light")
        for name, shape in self.shapes.items():
            _check_textures(name, shape)

    def parameters(self, tied: bool = False) -> dict[str, Array]:
        """Every continuous parameter by name (`spot.vertices`, `camera.to_world`, …), as `replace` takes them.

        With `tied`, parameters that are tied are one, by the name of the tie. Then ValueError is raised if they differ.
        """
        found = {name: get(self) for name, get in _accessors(self).items()}
        if not tied:
            return found
        for name, members in _ties(self, found).items():
            values = [found.pop(member) for member in members]
            _check_equal("Scene.parameters", name, members, values)
            found[name] = values[0]
        return found

    def replace(self, values: Mapping[str, ArrayLike]) -> "Scene":
        """The scene with some parameters replaced; pure and traceable.

        Concrete values are checked as by the constructors of the models. Traced ones can't be: the model takes the
        nearest value that it can compute with. The name of a tie sets all its parameters, so the derivative by it is
        the sum of theirs. Raises ValueError for an unknown name, a parameter that is given twice, a shape that differs
        from the parameter's, and concrete values that are out of range or not finite.
        """
        accessors = _accessors(self)
        ties = _ties(self, accessors)
        new: dict[str, Array] = {}
        for name, value in values.items():
            if name not in accessors and name not in ties:
                known = ", ".join([*accessors, *ties])
                raise ValueError(f"Scene.replace: unknown parameter {name!r}; this scene has: {known}")
            members = ties.get(name, (name,))
            old = accessors[members[0]](self)
            if jnp.shape(value) != old.shape:
                raise ValueError(f"Scene.replace: {name} has shape {old.shape}, got {jnp.shape(value)}")
            for member in members:
                if member in new:
                    raise ValueError(
                        f"Scene.replace: {member} is given twice, by its name and by a tie; give one value"
                    )
            new.update(dict.fromkeys(members, as_array(value, old.dtype)))
        if not new:
            return self
        getters = [accessors[name] for name in new]
        replaced = eqx.tree_at(lambda scene: [get(scene) for get in getters], self, list(new.values()))
        for name in new:
            owner, path = _owner(replaced, name)
            try:
                check_parameter(owner, path)
            except ValueError as error:
                raise ValueError(f"Scene.replace: {name}: {error}") from None
        return replaced

    def tie(self, ties: Mapping[str, Sequence[str]]) -> "Scene":
        """The scene with parameters tied: each name stands for several parameters of one value, in place of them.

        `replace({"red.reflectance": ...})` sets all that `red.reflectance` ties; `parameters(tied=True)` has it in
        their place. Their own names still work. A tie holds for those of its parameters that the scene has: one whose
        material is exchanged leaves it.

        Raises ValueError for a name that is a parameter's or another tie's, for fewer than two parameters, unknown
        ones and ones that are tied already, and for parameters whose shapes or values differ.
        """
        found = self.parameters()
        known = _ties(self, found)
        tied = {member: name for name, members in known.items() for member in members}
        for name, members in ties.items():
            if not name or name in found or name in known:
                raise ValueError(f"Scene.tie: {name!r} is taken or empty; give the tie a name of its own")
            if len(members) < 2:
                raise ValueError(f"Scene.tie: {name} ties {list(members)}; name two parameters or more")
            for member in members:
                if member not in found:
                    raise ValueError(f"Scene.tie: unknown parameter {member!r}; this scene has: {', '.join(found)}")
                if member in tied:
                    raise ValueError(
                        f"Scene.tie: {member} is tied by {tied[member]} already; it can be in one tie only"
                    )
                tied[member] = name
            values = [found[member] for member in members]
            if len({value.shape for value in values}) > 1:
                shapes = ", ".join(f"{member} {found[member].shape}" for member in members)
                raise ValueError(f"Scene.tie: {name}: the shapes differ: {shapes}; tie parameters of one shape")
            _check_equal("Scene.tie", name, members, values)
        pairs = {**known, **{name: tuple(members) for name, members in ties.items()}}
        return dataclasses.replace(self, tied=tuple(sorted(pairs.items())))

    def _repr_html_(self) -> str:
        """Tables of shapes, lights and parameters, for notebooks. Nothing is rendered."""
        return scene_html(self, {name: get(self) for name, get in _accessors(self).items()})


def every_parameter(scene: Scene) -> dict[str, Array]:
    """Every parameter by its own name, and the ties whose parameters have one value."""
    found = scene.parameters()
    values = {name: [found[member] for member in members] for name, members in _ties(scene, found).items()}
    return found | {name: first for name, (first, *_) in values.items() if _first_difference(values[name]) is None}


def _ties(scene: Scene, known: Mapping) -> dict[str, tuple[str, ...]]:
    """The ties of a scene, each with those of its parameters that are `known`; at least two."""
    kept = {name: tuple(member for member in members if member in known) for name, members in scene.tied}
    return {name: members for name, members in kept.items() if len(members) > 1}


def _check_equal(caller: str, tie: str, members: Sequence[str], values: Sequence[Array]) -> None:
    """Raises ValueError if the values of tied parameters differ. Traced ones pass."""
    other = _first_difference(values)
    if other is not None:
        raise ValueError(
            f"{caller}: {tie} is one parameter, and {members[0]} and {members[other]} differ; give both one value by "
            "Scene.replace first"
        )


def _first_difference(values: Sequence[Array]) -> int | None:
    """The number of the first value that differs from value number 0; None if all are one, or are traced."""
    if any(isinstance(value, Tracer) for value in values):
        return None
    pairs = (np.array_equal(value, values[0], equal_nan=True) for value in values)
    return next((number for number, equal in enumerate(pairs) if not equal), None)


def _models(scene: Scene) -> dict[str, eqx.Module]:
    """The models of a scene by the beginnings of the names of their parameters."""
    found: dict[str, eqx.Module] = {}
    for name, shape in scene.shapes.items():
        found[f"{name}.bsdf"] = unwrap(shape.bsdf)
        if shape.emitter is not None:
            found[f"{name}.emitter"] = shape.emitter
    found["camera"] = scene.camera
    if scene.environment is not None:
        found["environment"] = scene.environment
    return found | scene.lights


def _owner(scene: Scene, name: str) -> tuple[Any, str]:
    """(mesh or model, path of fields) of a parameter."""
    head, _, path = name.partition(".")
    if head in RESERVED:
        return getattr(scene, head), path
    if head in scene.lights:
        return scene.lights[head], path
    shape = scene.shapes[head]
    if path == "vertices":
        return shape.mesh, path
    part, _, path = path.partition(".")
    return (unwrap(shape.bsdf) if part == "bsdf" else shape.emitter), path


def _accessors(scene: Scene) -> dict:
    """Parameter name -> function that takes it from a scene."""

    def get(of, name):  # also of a scene whose leaves are no arrays
        owner, path = _owner(of, name)
        return attrgetter(path)(owner)

    names = []
    for key, model in _models(scene).items():
        if key.endswith(".bsdf"):
            names.append(f"{key.removesuffix('.bsdf')}.vertices")
        names += [f"{key}.{field}" for field in float_fields(model)]
    return {name: partial(get, name=name) for name in names}


def unwrap(bsdf: BSDF | TwoSided) -> BSDF:
    """The BSDF inside a `TwoSided` adapter, or the BSDF itself."""
    return bsdf.bsdf if isinstance(bsdf, TwoSided) else bsdf


def float_fields(module: eqx.Module) -> list[str]:
    """Names of the fields that are float arrays; those of modules inside (textures, inner BSDFs) follow a dot."""
    names = []
    for name in module.__dataclass_fields__:
        value = getattr(module, name)
        if isinstance(value, eqx.Module):
            names += [f"{name}.{inner}" for inner in float_fields(value)]
        elif isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
            names.append(name)
    return names


def textures_of(shape: Shape) -> list[tuple[str, Texture]]:
    """All textures of a shape, each with the name of its field below the shape, such as `bsdf.reflectance`."""
    bsdf = [(f"bsdf.{field}", texture) for field, texture in textures_in(unwrap(shape.bsdf))]
    return bsdf + [(f"emitter.{field}", texture) for field, texture in textures_in(shape.emitter)]


def _check_textures(name: str, shape: Shape) -> None:
    """Raises ValueError for a shape whose mesh lacks what its textures need."""
    mesh, bsdf = shape.mesh, unwrap(shape.bsdf)
    if bsdf.tangential and mesh.uvs is None:
        raise ValueError(
            f"Scene: {name}.bsdf has a normal map, a bump map or two roughnesses, and the mesh of {name!r} has no uvs, "
            "which define their axes"
        )
    for field, texture in [(field, part) for field, whole in textures_of(shape) for part in whole.parts]:
        owner = f"Scene: {name}.{field}, a {type(texture).__name__},"
        if texture.uses_uv and mesh.uvs is None:
            raise ValueError(
                f"{owner} needs texture coordinates, and the mesh of {name!r} has none (Mesh: uvs, uv_faces)"
            )
        kind, count = ("faces", mesh.faces.shape[0]) if texture.uses_faces else ("vertices", mesh.vertices.shape[0])
        if not texture.uses_uv and any(array.shape[0] != count for array in texture.data()):
            rows = texture.data()[0].shape[0]
            raise ValueError(f"{owner} has {rows} values, and the mesh of {name!r} has {count} {kind}")
