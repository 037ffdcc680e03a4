"""Mitsuba 3 scene files: what their elements mean. Their syntax is in `jaxdr.scene.mitsuba_xml`.

Each plugin has one small function, found by its type in a table (`SHAPES`, `BSDFS`, `FILTERS`). A type no table has,
and a parameter no function takes, is an error: a scene is never loaded in part.
"""

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import numpy as np

from jaxdr.geometry.load import load_mesh
from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.shapes import box, rectangle, sphere, transformed
from jaxdr.scene.bsdf import BSDF, Diffuse, TwoSided
from jaxdr.scene.camera import Perspective
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment
from jaxdr.scene.film import Box, Film, Gaussian, Tent
from jaxdr.scene.mitsuba_materials import MATERIALS
from jaxdr.scene.mitsuba_xml import Element, Properties, Variables, floats, read_xml
from jaxdr.scene.scene import RESERVED, Scene, Shape

# How an image is estimated, not what it shows: jaxdr.render has its own arguments for that.
INTEGRATORS = ("path", "direct", "prb", "prb_basic", "prb_projective", "direct_projective")
INTEGRATOR_SETTINGS = (
    *("max_depth", "rr_depth", "shading_samples", "emitter_samples", "bsdf_samples", "sppc", "sppp", "sppi"),
    *("guiding", "guiding_proj", "guiding_rounds"),
)
SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
SAMPLER_SETTINGS = ("sample_count", "seed", "jitter")
# How Mitsuba stores the image. Our pixels at the border always see beyond the film, as with its sample_border.
FILM_SETTINGS = ("file_format", "component_format", "sample_border", "compensate")
PIXEL_FORMATS = ("rgb", "rgba")  # there is no alpha channel here; the colours are the same
SENSOR_SETTINGS = ("shutter_open", "shutter_close")  # nothing moves in time

NUMBER = "float integer"
COLOR = "rgb spectrum float integer"
SPHERE_SUBDIVISIONS = 4  # 5120 triangles, within 0.1 % of the radius
FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)  # mm; `focal_length` is meant for this film format
# Linear sRGB of the spectrum that is 1 everywhere, seen as a light (XYZ = 1, 1, 1). As a reflectance it is plain 1.
EQUAL_ENERGY_LIGHT = np.array([1.204794, 0.948292, 0.908916])


def load_mitsuba(path: str | os.PathLike, /, **variables: object) -> Scene:
    """The scene in a Mitsuba 3 XML file.

    Keywords set the file's `$variables` and override its `<default>`s. Shapes are named by their XML ids; one without
    id by its type (`sphere`, `sphere_1`, …). Units and orientations are Mitsuba's, and files are looked up from the
    folder of the main scene file. A sphere becomes a mesh. Without `face_normals`, normals are interpolated and follow
    the vertices (`Mesh.vertex_normals`): those stored in a file only tell which corners share one; where none are
    stored, all corners at one position do (in Mitsuba: at one vertex of the file). Integrator and sampler are checked,
    but have no effect: `jaxdr.render` is given its own.

    Raises ValueError, which names file, line and tag, for whatever else there is: malformed XML, a missing file, a
    variable without value, an unknown element, plugin, attribute or parameter, a value out of range.
    """
    given = Variables(variables)
    root = read_xml(Path(path), given)
    if root.tag != "scene":
        raise root.error("the outermost element must be <scene>")
    if given.unknown:
        raise root.error(f"nothing in this scene uses the variable {', '.join(sorted(given.unknown))}")
    properties = Properties(root)
    reader = _Reader(root)
    for element in properties.objects("bsdf"):
        reader.bsdf(element)  # even if no shape refers to it, so that a mistake in it shows
    for element in properties.objects("integrator"):
        _integrator(element)
    camera, environment = properties.at_most_one("sensor"), properties.at_most_one("emitter")
    shapes = properties.objects("shape")
    properties.finish()
    if camera is None:
        raise root.error("the scene has no <sensor>")
    with root.located():
        return Scene(
            shapes={reader.shape_name(element): reader.shape(element) for element in shapes},
            camera=_camera(camera),
            environment=None if environment is None else _emitter(environment, "constant", ConstantEnvironment),
        )


class _Reader:
    """Reads shapes and BSDFs; it knows the ids of the whole file, and the folder other files are looked up from."""

    def __init__(self, root: Element):
        self.folder = root.file.parent
        self.by_id: dict[str, Element] = {}
        for element in _descendants(root):
            name = element.attributes.get("id")
            if name is not None and element.tag != "ref":
                if name in self.by_id:
                    first = self.by_id[name]
                    raise element.error(f"id {name!r} is taken by <{first.tag}> in {first.file}, line {first.line}")
                self.by_id[name] = element

    def shape_name(self, element: Element) -> str:
        """The id of a `<shape>`, or its type with the first free number."""
        name = element.attributes.get("id")
        if name is None:
            kind = element.attributes.get("type", "shape")
            candidates = (f"{kind}_{i}" if i else kind for i in range(len(self.by_id) + 1))
            name = next(candidate for candidate in candidates if candidate not in self.by_id)
            self.by_id[name] = element
        if not name or "." in name or name in RESERVED:
            raise element.error(f"id {name!r} can't name a shape (not empty, no dots, not {' or '.join(RESERVED)})")
        return name

    def shape(self, element: Element) -> Shape:
        """A `<shape>` in world space."""
        properties = Properties(element)
        mesh_of = properties.choose(SHAPES)
        to_world = properties.value("to_world", "transform", np.eye(4))
        flips = properties.value("flip_normals", "boolean", False)
        bsdf, emitter = properties.at_most_one("bsdf", "ref"), properties.at_most_one("emitter")
        with element.located():
            mesh, keeps_side = mesh_of(properties, self.folder)
            properties.finish()
            if not np.array_equal(to_world, np.eye(4)):
                # `transformed` keeps the outside outside; in Mitsuba a mirrored file's triangles turn over instead.
                flips ^= bool(np.linalg.det(to_world) < 0) and not keeps_side
                mesh = transformed(mesh, to_world)
            if flips:
                mesh = _reversed(mesh)
            if bsdf is None:
                material = Diffuse(0.5 if emitter is None else 0.0)  # Mitsuba's default: a light reflects nothing
            else:
                material = self.bsdf(bsdf)
            return Shape(mesh, material, None if emitter is None else _emitter(emitter, "area", AreaEmitter))

    def bsdf(self, element: Element) -> BSDF | TwoSided:
        """A `<bsdf>`, or the one a `<ref>` stands for."""
        properties = Properties(self.referenced(element))
        with properties.element.located():
            bsdf = properties.choose(BSDFS)(properties, self)
        properties.finish()
        return bsdf

    def referenced(self, element: Element) -> Element:
        """The `<bsdf>` a `<ref>` stands for; a `<bsdf>` stands for itself."""
        if element.tag == "bsdf":
            return element
        element.check_attributes(("id",), ("name",))
        target = self.by_id.get(element.attributes["id"])
        if target is None or target.tag != "bsdf":
            raise element.error(f"there is no bsdf with id {element.attributes['id']!r}")
        return target


def _descendants(element: Element) -> Iterator[Element]:
    for child in element.children:
        yield child
        yield from _descendants(child)


# Shapes: (properties, folder) -> the mesh before to_world, and whether mirroring leaves its outside outside in Mitsuba.


def _mesh_file(properties: Properties, folder: Path) -> tuple[Mesh, bool]:
    filename = properties.value("filename", "string")
    face_normals = properties.value("face_normals", "boolean", False)
    if filename is None:
        raise ValueError("parameter 'filename' is missing")
    if Path(filename).suffix.lower() != f".{properties.type}":
        raise ValueError(f"{filename} is not a .{properties.type} file")
    mesh = load_mesh(folder / filename, shading="flat" if face_normals else "file")
    has_stored_normals = mesh.normal_faces is not None
    # Where a file stores no normals, Mitsuba computes smooth ones. Stored ones keep their side when mirrored.
    return mesh if face_normals or has_stored_normals else mesh.smooth(), has_stored_normals


def _rectangle(properties: Properties, folder: Path) -> tuple[Mesh, bool]:
    properties.ignore("face_normals")  # flat anyway
    return rectangle(2.0, 2.0), True


def _cube(properties: Properties, folder: Path) -> tuple[Mesh, bool]:
    properties.ignore("face_normals")  # flat anyway
    return box((2.0, 2.0, 2.0)), True


def _sphere(properties: Properties, folder: Path) -> tuple[Mesh, bool]:
    radius = properties.value("radius", NUMBER, 1.0)
    center = properties.value("center", "point vector", np.zeros(3))
    return sphere(SPHERE_SUBDIVISIONS, radius, center).smooth(), False


SHAPES: dict[str, Callable[[Properties, Path], tuple[Mesh, bool]]] = {
    "obj": _mesh_file,
    "ply": _mesh_file,
    "rectangle": _rectangle,
    "cube": _cube,
    "sphere": _sphere,
}


def _reversed(mesh: Mesh) -> Mesh:
    """The mesh inside out."""
    turned = {
        name: None if faces is None else np.asarray(faces)[:, ::-1]
        for name, faces in (("uv_faces", mesh.uv_faces), ("normal_faces", mesh.normal_faces))
    }
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)[:, ::-1], mesh.uvs, **turned)


# BSDFs: (properties, reader) -> BSDF.


def _diffuse(properties: Properties, reader: _Reader) -> Diffuse:
    reflectance = properties.value("reflectance", COLOR, 0.5)
    if np.min(reflectance) < 0 or np.max(reflectance) > 1:
        raise ValueError(f"reflectance must be in [0, 1], got {np.asarray(reflectance).tolist()}")
    return Diffuse(reflectance)


def _two_sided(properties: Properties, reader: _Reader) -> TwoSided:
    inner = properties.at_most_one("bsdf", "ref")
    if inner is None:
        raise ValueError("needs a <bsdf> inside")
    if reader.referenced(inner).attributes.get("type") == "twosided":  # checked before reading: <ref>s may form a cycle
        raise inner.error("the BSDF inside is two-sided already")
    return TwoSided(cast(BSDF, reader.bsdf(inner)))


BSDFS: dict[str, Callable[[Properties, _Reader], BSDF | TwoSided]] = {
    "diffuse": _diffuse,
    "twosided": _two_sided,
    **{name: lambda properties, _, make=make: make(properties) for name, make in MATERIALS.items()},
}


def _emitter(element: Element, kind: str, make: Callable):
    """An emitter that has a radiance and nothing else."""
    properties = Properties(element)
    properties.choose({kind: make})
    tint = EQUAL_ENERGY_LIGHT if properties.tag("radiance") == "spectrum" else 1.0
    radiance = tint * properties.value("radiance", COLOR, 1.0)
    properties.finish()
    with element.located():
        return make(radiance)


# Camera and film.


def _camera(element: Element) -> Perspective:
    properties = Properties(element)
    properties.choose({"perspective": Perspective})
    for name in ("principal_point_offset_x", "principal_point_offset_y"):
        if properties.value(name, NUMBER, 0.0) != 0:
            raise element.error(f"{name} other than 0 is not supported")
    to_world = properties.value("to_world", "transform", np.eye(4))
    if not np.allclose(to_world[:3, :3].T @ to_world[:3, :3], np.eye(3), atol=1e-3):
        raise element.error("to_world must not scale or shear")
    near, far = properties.value("near_clip", NUMBER, 1e-2), properties.value("far_clip", NUMBER, 1e4)
    sampler = properties.at_most_one("sampler")
    if sampler is not None:
        _without_effect(Properties(sampler), SAMPLERS, SAMPLER_SETTINGS)
    properties.ignore(*SENSOR_SETTINGS)
    film = _film(properties.at_most_one("film"))
    with element.located():
        fov, axis = _field_of_view(properties)
        properties.finish()
        return Perspective(to_world, fov, film, axis, near, far)


def _field_of_view(properties: Properties) -> tuple[float, str]:
    """Degrees and the axis they are measured along, from `fov` or `focal_length` (default 50mm)."""
    fov = properties.value("fov", NUMBER)
    axis = properties.value("fov_axis", "string", "x")
    focal_length = properties.value("focal_length", "string")
    if fov is not None:
        if focal_length is not None:
            raise ValueError("give either fov or focal_length, not both")
        if not 0 < fov < 180:
            raise ValueError(f"fov must be between 0 and 180 degrees, got {fov}")
        return fov, axis
    millimetres = floats((focal_length or "50mm").removesuffix("mm"), 1)[0]
    if millimetres <= 0:
        raise ValueError(f"focal_length must be positive, got {focal_length}")
    return math.degrees(2 * math.atan(0.5 * FULL_FRAME_DIAGONAL / millimetres)), "diagonal"


def _film(element: Element | None) -> Film:
    """A `<film>`, or Mitsuba's default."""
    if element is None:
        return Film(768, 576)
    properties = Properties(element)
    properties.choose({"hdrfilm": Film})
    width, height = properties.value("width", "integer", 768), properties.value("height", "integer", 576)
    names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
    defaults = (0, 0, width, height)
    crop = tuple(properties.value(n, "integer", d) for n, d in zip(names, defaults, strict=True))
    pixel_format = properties.value("pixel_format", "string", "rgb")
    if pixel_format not in PIXEL_FORMATS:
        raise element.error(f"pixel_format must be {' or '.join(PIXEL_FORMATS)}, got {pixel_format!r}")
    rfilter = properties.at_most_one("rfilter")
    properties.ignore(*FILM_SETTINGS)
    properties.finish()
    with element.located():
        return Film(width, height, _filter(rfilter), None if crop == defaults else crop)


FILTERS = {"box": (Box, ()), "gaussian": (Gaussian, ("stddev",)), "tent": (Tent, ("radius",))}


def _filter(element: Element | None) -> Box | Gaussian | Tent:
    """An `<rfilter>`, or Mitsuba's default."""
    if element is None:
        return Gaussian()
    properties = Properties(element)
    make, settings = properties.choose(FILTERS)
    given = {name: properties.value(name, NUMBER) for name in settings if properties.tag(name)}
    properties.finish()
    with element.located():
        return make(**given)


# Elements without effect.


def _integrator(element: Element) -> None:
    properties = Properties(element)
    if properties.value("hide_emitters", "boolean", False):
        raise element.error("hide_emitters is not supported")
    _without_effect(properties, INTEGRATORS, INTEGRATOR_SETTINGS)


def _without_effect(properties: Properties, types: tuple[str, ...], settings: tuple[str, ...]) -> None:
    """Check a plugin that doesn't change what the image shows."""
    properties.choose(dict.fromkeys(types))
    properties.ignore(*settings)
    properties.finish()
