"""Mitsuba 3 scene files: from the tree of elements to a `Scene`.

Plugins are in tables, one in each of the files `shapes`, `bsdfs`, `textures`, `emitters` and `sensors`. `xml` says how
a plugin is read. A new plugin is one function and one line in its table.
"""

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import equinox as eqx
import numpy as np

from jaxdr.argument_kinds import checked
from jaxdr.scene.formats.mitsuba.document import descendants, read_document
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.emitters import SHAPE_EMITTERS, read_emitters
from jaxdr.scene.formats.mitsuba.scene_shapes import SceneShapes
from jaxdr.scene.formats.mitsuba.sensors import chosen_sensor, read_film, read_filter, read_sampler, read_sensor
from jaxdr.scene.formats.mitsuba.shapes import Plan
from jaxdr.scene.formats.mitsuba.textures import TEXTURES
from jaxdr.scene.formats.mitsuba.xml import Properties, read_plugin
from jaxdr.scene.formats.ties import Made, tie_shared
from jaxdr.scene.scene import Scene

INTEGRATOR_SETTINGS = (
    *("max_depth", "rr_depth", "shading_samples", "emitter_samples", "bsdf_samples", "sppc", "sppp", "sppi"),
    *("guiding", "guiding_proj", "guiding_rounds"),
)


@checked
def load_mitsuba(
    path: str | os.PathLike,
    /,
    *,
    sensor: str | int | None = None,
    ignore_unsupported: bool = False,
    **variables: object,
) -> Scene:
    """The scene in a Mitsuba 3 XML file. Units and orientations are Mitsuba's.

    - Other keywords set the file's `$variables` and override its `<default>`s.
    - The camera is the one `<sensor>`. If there are several, `sensor` is the id or the number, from 0, of the one.
    - Shapes are named by their XML ids. A shape without id is named by its type (`sphere`, `sphere_1`, …). An instance
      of several shapes gives each of them a name of three parts: the name of the instance, `_`, and that of the shape.
    - A BSDF, texture or emitter that several shapes refer to by its id has parameters of its own, `<id>.reflectance`:
      `Scene.replace` sets those of all shapes by it, and `Scene.parameters(tied=True)` lists it (`Scene.tie`).
    - Everything becomes meshes, and instances become copies of them. The module `shapes` says how fine they are, and
      where their normals come from. UVs have (0, 0) at an image's lower left, as in OBJ files.
    - Integrator and sampler are checked, but have no effect: `jaxdr.render` has arguments of its own for them.

    Raises one ValueError that lists all problems with file, line and tag: mistakes (values out of range, missing files,
    ids) and what is not supported (elements, plugins, parameters that nothing reads). With `ignore_unsupported` the
    latter become warnings that say what happens instead. Malformed XML, and a variable without value, raise at once.
    Mesh files are read last, and their problems come in an error of their own. Warns of settings that are not read and
    don't change the expected image.
    """
    root = read_document(Path(path), variables)
    properties, shapes = Properties(root), SceneShapes()
    for element in properties.objects("bsdf"):
        shapes.bsdf(element)  # even if no shape refers to it, so that a mistake in it shows
    for element in properties.objects("texture", "spectrum"):
        read_plugin(element, TEXTURES, "it is left out")
    for element in properties.objects("integrator"):
        _read_integrator(element)
    for tag, read in (("film", read_film), ("rfilter", read_filter), ("sampler", read_sampler)):
        for element in properties.objects(tag):
            _read_part(element, read)
    seen_by = chosen_sensor(root, properties.objects("sensor"), sensor)
    camera = None if seen_by is None else read_sensor(seen_by)
    plans = shapes.plans(properties.objects("shape"))
    emitters = properties.objects("emitter")
    for element in emitters:
        if element.type in SHAPE_EMITTERS:
            _read_part(element, shapes.emitter)
    others = [element for element in emitters if element.type not in SHAPE_EMITTERS]
    environment, lights = read_emitters(others, plans)
    properties.finish()
    if seen_by is None:
        root.problems.add(root, root.place("the scene has no <sensor>"))
    root.problems.check(Path(path), ignore_unsupported)
    if camera is None:
        raise seen_by.error("the scene has no other sensor that could take its place")
    meshes = {name: shapes.shape(plan) for name, plan in plans.items()}
    root.problems.check(Path(path), ignore_unsupported)
    found = {name: shape for name, shape in meshes.items() if shape is not None}
    if not found:
        raise root.error("the scene has no <shape> that can be seen; it needs at least one")
    with root.located():
        scene = Scene(shapes=found, camera=camera, environment=environment, lights=lights)
        _check_finite(scene)
        return tie_shared(scene, _made(root, plans.values()))


def _check_finite(scene: Scene) -> None:
    """Raises ValueError for a parameter that is not finite: numbers in range may overflow where they are multiplied."""
    for name, value in scene.parameters().items():
        if not np.isfinite(np.asarray(value)).all():
            raise ValueError(f"{name} is not finite: numbers of the file are too large together")


def _made(root: Element, plans: Iterable[Plan]) -> list[Made]:
    """What was made of all elements with ids, and of the BSDFs and emitters without ids of instances."""
    named = [element for _, element in descendants(root) if "id" in element.attributes]
    found = {id(element.made): (element.attributes["id"], "", element) for element in named if element.tag != "shape"}
    for plan in plans:
        owner = plan.element.attributes.get("id", plan.element.type)
        for element in (plan.bsdf, plan.emitter) if plan.instance is not None else ():
            if element is not None:
                found.setdefault(id(element.made), (owner, f".{element.tag}", element))
    made = [Made(name, kind, each) for name, kind, element in found.values() for each in element.made.values()]
    return [each for each in made if each.modules and all(isinstance(m, eqx.Module) for m in each.modules)]


def _read_part(element: Element, read: Callable[[Element], object]) -> None:
    """Read an element that is in the scene only for others to refer to."""
    read(element)
    if not element.referred:
        element.harmless("nothing refers to it: it has no effect")


def _integrator(element: Element) -> None:
    """An integrator says how the image is estimated. `jaxdr.render` has its own arguments for that."""
    properties = Properties(element)
    if properties.value("hide_emitters", "boolean", False):
        element.unsupported("hide_emitters is not supported", "emitters stay visible")
    properties.ignore(*INTEGRATOR_SETTINGS)


def _several_images(element: Element) -> None:
    """An integrator that adds images to those of the ones inside. `jaxdr.render_aovs` has its own names for them."""
    properties = Properties(element)
    properties.ignore("aovs")
    for inner in properties.objects("integrator"):
        _read_integrator(inner)


def _read_integrator(element: Element) -> None:
    """Check an `<integrator>`. Unknown ones only give a warning, except for those that don't show light."""
    if element.type in INTEGRATORS or element.type in NO_LIGHT or "type" not in element.attributes:
        read_plugin(element, INTEGRATORS, "it has no effect")
        return
    element.harmless(f"unknown type {element.type!r}: it has no effect, jaxdr.render takes an integrator of its own")
    hidden = next((child for child in element.children if child.attributes.get("name") == "hide_emitters"), None)
    if hidden is not None and hidden.attributes.get("value", "").lower() == "true":
        element.unsupported("hide_emitters is not supported", "emitters stay visible")


NO_LIGHT = ("ao", "depth", "field", "multichannel", "stokes")
SAME_IMAGE = (  # without media
    *("path", "direct", "volpath", "volpathmis", "ptracer"),
    *("prb", "prb_basic", "prbvolpath", "prb_projective", "direct_projective"),
)
INTEGRATORS: dict[str, Callable[[Element], None]] = {
    **dict.fromkeys(SAME_IMAGE, _integrator),
    **dict.fromkeys(("aov", "moment"), _several_images),
}
