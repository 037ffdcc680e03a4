"""Mitsuba 3 scene files: from the tree of elements to a `Scene`.

The plugins are in tables, a file each: `mitsuba_shapes`, `mitsuba_bsdfs`, `mitsuba_textures`, `mitsuba_emitters`,
`mitsuba_sensors`; how one is read is in `mitsuba_xml`. A new plugin is one function and one line in its table.
"""

import os
from collections.abc import Callable
from pathlib import Path

from jaxdr.scene.mitsuba_bsdfs import read_bsdf
from jaxdr.scene.mitsuba_document import read_document
from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_emitters import read_emitters
from jaxdr.scene.mitsuba_sensors import read_sensor
from jaxdr.scene.mitsuba_shapes import read_shapes
from jaxdr.scene.mitsuba_textures import TEXTURES
from jaxdr.scene.mitsuba_xml import Properties, read_plugin
from jaxdr.scene.scene import Scene

INTEGRATOR_SETTINGS = (
    *("max_depth", "rr_depth", "shading_samples", "emitter_samples", "bsdf_samples", "sppc", "sppp", "sppi"),
    *("guiding", "guiding_proj", "guiding_rounds"),
)


def load_mitsuba(path: str | os.PathLike, /, *, ignore_unsupported: bool = False, **variables: object) -> Scene:
    """The scene in a Mitsuba 3 XML file. Units and orientations are Mitsuba's.

    - Keywords set the file's `$variables` and override its `<default>`s.
    - Shapes are named by their XML ids, one without id by its type (`sphere`, `sphere_1`, …). Those of an instance of
      several are named by its name, `_` and theirs.
    - Everything becomes meshes, and instances become copies of them. `jaxdr.scene.mitsuba_shapes` says how fine they
      are, and where their normals come from. UVs have (0, 0) at an image's lower left, as in OBJ files.
    - Integrator and sampler are checked, but have no effect: `jaxdr.render` is given its own.

    Raises one ValueError that names file, line and tag of all that is wrong (values out of range, missing files, ids)
    or not supported (elements, plugins, parameters that nobody reads). With `ignore_unsupported` the latter become
    warnings that say what happens instead. Malformed XML, and a variable without value, are raised at once.
    """
    root = read_document(Path(path), variables)
    properties = Properties(root)
    for element in properties.objects("bsdf"):
        read_bsdf(element)  # even if no shape refers to it, so that a mistake in it shows
    for element in properties.objects("texture", "spectrum"):
        read_plugin(element, TEXTURES, "it is left out")
    for element in properties.objects("integrator"):
        read_plugin(element, INTEGRATORS, "it has no effect")
    sensor = properties.at_most_one("sensor")
    camera = None if sensor is None else read_sensor(sensor)
    shapes = read_shapes(properties.objects("shape"))
    environment, lights = read_emitters(properties.objects("emitter"), shapes)
    properties.finish()
    if sensor is None:
        root.problems.add(root, root.place("the scene has no <sensor>"))
    root.problems.check(Path(path), ignore_unsupported)
    if camera is None:
        raise sensor.error("the scene has no other sensor that could take its place")
    with root.located():
        return Scene(shapes=shapes, camera=camera, environment=environment, lights=lights)


def _integrator(element: Element) -> None:
    """How an image is estimated, not what it shows: `jaxdr.render` has its own arguments for that."""
    properties = Properties(element)
    if properties.value("hide_emitters", "boolean", False):
        element.unsupported("hide_emitters is not supported", "emitters stay visible")
    properties.ignore(*INTEGRATOR_SETTINGS)


def _several_images(element: Element) -> None:
    """What is added to the image of the integrator inside; `jaxdr.render_aovs` has its own names for that."""
    properties = Properties(element)
    properties.ignore("aovs")
    for inner in properties.objects("integrator"):
        read_plugin(inner, INTEGRATORS, "it has no effect")


SAME_IMAGE = (  # without media
    *("path", "direct", "volpath", "volpathmis", "ptracer"),
    *("prb", "prb_basic", "prbvolpath", "prb_projective", "direct_projective"),
)
INTEGRATORS: dict[str, Callable[[Element], None]] = {
    **dict.fromkeys(SAME_IMAGE, _integrator),
    **dict.fromkeys(("aov", "moment"), _several_images),
}
