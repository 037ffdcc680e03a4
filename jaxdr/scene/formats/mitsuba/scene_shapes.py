"""The shapes of a Mitsuba 3 scene. All of them are checked first, and their meshes are made after that.

Groups are flattened: an instance is a copy of the group's meshes in another place.
"""

import functools

import numpy as np

from jaxdr.geometry.mesh import EmptyMesh, Mesh, has_area
from jaxdr.geometry.shapes import transformed_arrays
from jaxdr.scene.bsdf import BSDF, Diffuse, TwoSided
from jaxdr.scene.emitters import AreaEmitter
from jaxdr.scene.formats.attributes import Attributes
from jaxdr.scene.formats.mitsuba.bsdfs import read_bsdf
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.emitters import read_shape_emitter
from jaxdr.scene.formats.mitsuba.names import object_names, parameter_name
from jaxdr.scene.formats.mitsuba.shapes import SHAPES, Plan
from jaxdr.scene.formats.mitsuba.xml import REASONS, Properties, read_plugin
from jaxdr.scene.scene import Shape
from jaxdr.untrusted import LARGEST

MOST_SHAPES = 10_000  # with those that instances copy: each is a mesh of its own


class SceneShapes:
    """Reads shapes, their BSDFs and their emitters. Problems are added to those of the elements."""

    def __init__(self) -> None:
        self._groups = {"shapegroup": self._group, "instance": self._instance}

    def plans(self, elements: list[Element]) -> dict[str, Plan]:
        """Plans of the visible shapes of a scene, by name. BSDFs and emitters are read, but meshes are not yet.

        A `<shape>` has one plan, an instance one for each shape of its group, and a group alone none. An instance of
        several shapes gives each of them a name of three parts: the name of the instance, `_`, and that of the shape.
        Names that can't be used are noted as problems.
        """
        found: dict[str, Plan] = {}
        for name, element in zip(object_names(elements), elements, strict=True):
            if element.type in self._groups:
                inside = read_plugin(element, self._groups, "it is left out") or []
                shapes = [(f"{name}_{inner}" if len(inside) > 1 else name, plan) for inner, plan in inside]
            else:
                shapes = [(name, self._plan(element))]
            for wanted, plan in shapes:
                whole = parameter_name(element, wanted)
                if whole in found:
                    message = f"a second shape {whole!r}; give one of them another id"
                    element.problems.add(element, element.place(message))
                elif plan is not None and element.type != "shapegroup":
                    found[whole] = plan
            if len(found) > MOST_SHAPES:
                raise element.error(f"the scene has more than {MOST_SHAPES} shapes; join them into fewer mesh files")
        return found

    def shape(self, plan: Plan) -> Shape | None:
        """The shape in world space. If it can't be made, it is None, and that is noted as a problem."""
        try:
            mesh, attributes = _mesh(plan)
        except EmptyMesh as error:
            plan.element.unsupported(str(error), "the shape is left out")
            return None
        except (ValueError, OSError) as error:
            plan.element.problems.add(plan.element, plan.element.place(str(error)))
            return None
        for element in (plan.bsdf, plan.emitter):
            if element is not None:
                element.vertex_data = attributes
        emitter = self.emitter(plan.emitter)
        bsdf = Diffuse(0.5 if plan.emitter is None else 0.0)  # Mitsuba's defaults: a light reflects nothing
        if plan.bsdf is not None:
            bsdf = self.bsdf(plan.bsdf) or bsdf
        return Shape(mesh, bsdf, emitter)

    def bsdf(self, element: Element) -> BSDF | TwoSided | None:
        """The BSDF of an element. It is None for a surface that rays pass through, and that is noted as a problem."""
        if element.type == "null":
            element.unsupported(f"unknown type 'null'; {REASONS['null']}", "shapes that have it are left out")
            return None
        return read_bsdf(element)

    def emitter(self, element: Element | None) -> AreaEmitter | None:
        """The emitter of an element, or None."""
        return None if element is None else read_shape_emitter(element)

    def _plan(self, element: Element) -> Plan | None:
        """The plan of a `<shape>`, with its BSDF and emitter checked; None if it can't be read or can't be seen."""
        plan = read_plugin(element, SHAPES, "it is left out")
        if plan is None:
            return None
        self.emitter(plan.emitter)
        passable = plan.bsdf is not None and self.bsdf(plan.bsdf) is None
        return None if passable else plan

    def _group(self, element: Element) -> list[tuple[str, Plan]]:
        """The shapes of a group with their names. Only instances make them visible."""
        inside = Properties(element).objects("shape")
        plans = [(name, self._plan(child)) for name, child in zip(object_names(inside), inside, strict=True)]
        return [(name, plan._replace(make=functools.cache(plan.make))) for name, plan in plans if plan is not None]

    def _instance(self, element: Element) -> list[tuple[str, Plan]]:
        """The shapes of a group in another place, as meshes of their own."""
        properties = Properties(element)
        to_world = properties.value("to_world", "transform", np.eye(4))
        group = properties.at_most_one("shape")
        if group is None or group.type != "shapegroup":
            raise ValueError("needs a shapegroup inside")
        inside = read_plugin(group, self._groups, "it is left out") or []
        return [(name, plan._replace(instance=to_world)) for name, plan in inside]


def _mesh(plan: Plan) -> tuple[Mesh, Attributes]:
    """The mesh in world space, and its attributes."""
    source = plan.make()
    arrays, flips = source.arrays, plan.flips
    if not np.array_equal(plan.to_world, np.eye(4)):
        # `transformed_arrays` keeps the outside outside. In Mitsuba the triangles of a mirrored file turn over instead.
        flips ^= bool(np.linalg.det(plan.to_world) < 0) and not source.keeps_side
        arrays = transformed_arrays(arrays, plan.to_world)
    if flips:
        arrays = arrays.turned()
    if plan.instance is not None:
        arrays = transformed_arrays(arrays, plan.instance)
    if not (np.abs(arrays.vertices) <= LARGEST).all():
        raise ValueError(f"its vertices go beyond {LARGEST:g}; repair to_world or the mesh")
    mesh = Mesh(*arrays)
    attributes = source.attributes
    if len(mesh.faces) < len(arrays.faces):  # `Mesh` drops faces without area
        kept = has_area(np.asarray(mesh.vertices), arrays.faces)
        attributes = {
            name: values[kept] if name.startswith("face_") and values is not None else values
            for name, values in attributes.items()
        }
    return mesh, attributes
