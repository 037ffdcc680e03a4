"""Scene: shapes, camera, environment and lights as one pytree with named parameters."""

from collections.abc import Mapping
from operator import attrgetter

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from jaxdr.arrays import as_array
from jaxdr.geometry.mesh import Mesh
from jaxdr.scene.bsdf import BSDF, Diffuse, TwoSided
from jaxdr.scene.camera import Camera
from jaxdr.scene.emitters import AreaEmitter, Environment
from jaxdr.scene.lights import DeltaLight
from jaxdr.scene.ranges import check_parameter
from jaxdr.scene.textures import Texture, textures_in

RESERVED = ("camera", "environment")


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

    def __check_init__(self):
        for name, kind in (("mesh", Mesh), ("bsdf", (BSDF, TwoSided)), ("emitter", (AreaEmitter, type(None)))):
            value = getattr(self, name)
            if not isinstance(value, kind):
                raise ValueError(f"Shape: {name} can't be a {type(value).__name__}")


def _sorted_by_id(members: Mapping) -> dict:
    # JAX sorts dictionaries when it flattens them: sorting here keeps the order the same before and after.
    return dict(sorted(members.items()))


class Scene(eqx.Module):
    """Shapes, a camera and lights: what `render` draws.

    - `shapes`: `Shape`s by id; at least one.
    - `camera`: a `Perspective`, `ThinLens` or `Orthographic`, with its film.
    - `environment`: light from infinitely far away, or None for black.
    - `lights`: lights without area, by id.

    Names of `parameters` begin with an id. Raises ValueError for a scene without shapes, for an id that is empty, has a
    dot, is `camera` or `environment`, or names both a shape and a light, and for textures that do not fit the mesh of
    their shape.
    """

    shapes: dict[str, Shape] = eqx.field(converter=_sorted_by_id)
    camera: Camera
    environment: Environment | None = None
    lights: dict[str, DeltaLight] = eqx.field(converter=_sorted_by_id, default_factory=dict)

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

    def parameters(self) -> dict[str, Array]:
        """Every continuous parameter by name (`spot.vertices`, `camera.to_world`, …), as `replace` takes them."""
        return {name: get(self) for name, get in _accessors(self).items()}

    def replace(self, values: Mapping[str, ArrayLike]) -> "Scene":
        """The scene with some parameters replaced; pure and traceable.

        Concrete values are checked as by the constructors of the models. Traced ones can't be: the model takes the
        nearest value that it can compute with. Raises ValueError for an unknown name, for a shape that differs from the
        parameter's, and for concrete values that are out of range or not finite.
        """
        accessors = _accessors(self)
        for name, value in values.items():
            if name not in accessors:
                raise ValueError(f"Scene.replace: unknown parameter {name!r}; this scene has: {', '.join(accessors)}")
            old = accessors[name](self)
            if jnp.shape(value) != old.shape:
                raise ValueError(f"Scene.replace: {name} has shape {old.shape}, got {jnp.shape(value)}")
        if not values:
            return self
        getters = [accessors[name] for name in values]
        new = [as_array(v, get(self).dtype) for v, get in zip(values.values(), getters, strict=True)]
        replaced = eqx.tree_at(lambda scene: [get(scene) for get in getters], self, new)
        for name in values:
            owner, path = _owner(replaced, name)
            try:
                check_parameter(owner, path)
            except ValueError as error:
                raise ValueError(f"Scene.replace: {name}: {error}") from None
        return replaced


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


def _owner(scene: Scene, name: str) -> tuple[eqx.Module, str]:
    """(model, path of fields) of a parameter."""
    if name.endswith(".vertices") and (shape := name.removesuffix(".vertices")) in scene.shapes:
        return scene.shapes[shape].mesh, "vertices"
    return next((m, name.removeprefix(f"{key}.")) for key, m in _models(scene).items() if name.startswith(f"{key}."))


def _accessors(scene: Scene) -> dict:
    """Parameter name -> function that takes it from a scene."""
    found = {}
    for key, model in _models(scene).items():
        if key.endswith(".bsdf"):
            name = key.removesuffix(".bsdf")
            found[f"{name}.vertices"] = lambda s, n=name: s.shapes[n].mesh.vertices
        for field in _float_fields(model):
            found[f"{key}.{field}"] = lambda s, k=key, f=field: attrgetter(f)(_models(s)[k])
    return found


def unwrap(bsdf: BSDF | TwoSided) -> BSDF:
    """The BSDF inside a `TwoSided` adapter, or the BSDF itself."""
    return bsdf.bsdf if isinstance(bsdf, TwoSided) else bsdf


def _float_fields(module: eqx.Module) -> list[str]:
    """Names of the fields that are float arrays; those of modules inside (textures, inner BSDFs) follow a dot."""
    names = []
    for name in module.__dataclass_fields__:
        value = getattr(module, name)
        if isinstance(value, eqx.Module):
            names += [f"{name}.{inner}" for inner in _float_fields(value)]
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
