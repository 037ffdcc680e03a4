"""What stands around the object of a run: shapes that do not change, and materials. Lengths are in scene units."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxdr.geometry import shapes
from jaxdr.geometry.load import load_mesh
from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.shapes import centred, transformed
from jaxdr.optimize.config_checks import check_choice, check_options, positive, require
from jaxdr.scene import bsdf as materials
from jaxdr.scene.bsdf import BSDF, TwoSided
from jaxdr.scene.camera import look_at
from jaxdr.scene.scene import Shape

Vector = tuple[float, float, float]

PROCEDURAL = {
    name: getattr(shapes, name)
    for name in ("rectangle", "plane", "box", "sphere", "displaced_sphere", "torus", "trefoil_tube", "pawn", "duck")
}
MATERIALS = {
    name: getattr(materials, name)
    for name in (
        "Diffuse",
        "RoughConductor",
        "Conductor",
        "RoughDielectric",
        "Dielectric",
        "RoughPlastic",
        "Plastic",
        "Phong",
        "Principled",
    )
}


@dataclass(frozen=True)
class FixedShape:
    """A shape beside the object: a procedural `shape` with `parameters`, or the mesh at `path`.

    With `size` it is centred, and its longest side is that long. It is moved to `position`. With `target` its z axis
    points there: a rectangle faces the target. `material` has a `kind`, a name of `MATERIALS`, and that class's
    arguments.
    """

    shape: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)
    path: str = ""
    size: float | None = None
    position: Vector = (0.0, 0.0, 0.0)
    target: Vector | None = None
    material: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        require(bool(self.shape) != bool(self.path), "shape", "give either a shape or a path", self.shape)
        positive(self, "size")
        require(self.target != self.position, "position", "must differ from target", self.position)
        if self.shape:
            check_choice("shape", self.shape, PROCEDURAL)
            check_options("parameters", PROCEDURAL[self.shape], self.parameters, self.shape, "parameter")
        elif self.parameters:
            raise ValueError("parameters: only a procedural shape has parameters, a mesh file has none")
        material_of(self.material)

    def build(self) -> Shape:
        """The shape in its place. Raises ValueError when its mesh can't be built or loaded."""
        return Shape(self.mesh(), material_of(self.material))

    def mesh(self) -> Mesh:
        """The mesh in its place."""
        try:
            mesh = load_mesh(self.path) if self.path else PROCEDURAL[self.shape](**self.parameters)
        except TypeError as problem:
            raise ValueError(f"parameters: {problem}") from None
        mesh = mesh if self.size is None else centred(mesh, self.size)
        return transformed(mesh, placed(self.position, self.target))


def material_of(options: dict[str, Any], default: Any = 0.5) -> BSDF | TwoSided:
    """The BSDF that `kind` names, with the other options as its arguments; without options diffuse grey.

    Those that are black from behind become two-sided. Raises ValueError that starts with the key.
    """
    kind = options.get("kind", "Diffuse")
    check_choice("material.kind", kind, MATERIALS)
    arguments = {name: value for name, value in options.items() if name != "kind"}
    check_options("material", MATERIALS[kind], arguments, kind)
    if kind == "Diffuse" and not arguments:
        arguments = {"reflectance": default}
    try:
        made = MATERIALS[kind](**arguments)
    except (TypeError, ValueError) as problem:
        raise ValueError(f"material: {problem}") from None
    return made if made.transmissive else TwoSided(made)


def placed(position: Vector, target: Vector | None) -> np.ndarray:
    """The matrix [4, 4] that moves the origin to `position` and turns z towards `target`, if there is one."""
    if target is None:
        matrix = np.eye(4)
        matrix[:3, 3] = position
        return matrix
    straight = np.allclose(np.cross(np.subtract(target, position), (0, 0, 1)), 0)
    return np.asarray(look_at(position, target, (0, 1, 0) if straight else (0, 0, 1)))
