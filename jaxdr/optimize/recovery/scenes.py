"""Scenes that a recovery starts from: procedural ones by name, z up and around the origin, and scene files.

A procedural scene is one function and one line in `SCENES`.
"""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jaxdr.geometry import shapes
from jaxdr.geometry.load import load_mesh
from jaxdr.geometry.shapes import centred, plane, transformed
from jaxdr.geometry.uvs import spherical_uvs
from jaxdr.optimize.config import TARGET_SHAPES
from jaxdr.optimize.config_checks import check_choice, check_options
from jaxdr.scene.bsdf import Diffuse, RoughConductor, TwoSided
from jaxdr.scene.camera import Perspective, look_at
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment
from jaxdr.scene.environment_map import EnvironmentMap
from jaxdr.scene.film import Film
from jaxdr.scene.formats.gltf.load import is_gltf, load_gltf
from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.lights import PointLight
from jaxdr.scene.scene import Scene, Shape
from jaxdr.scene.textures import Bitmap

FLOOR = -0.6
ROUND = ("duck", "sphere", "displaced_sphere")  # of the `TARGET_SHAPES`, those whose first argument is subdivisions
TEXTURES = ("patches", "plain")


def textured_object(
    *,
    shape: str = "duck",
    subdivisions: int = 4,
    size: float = 1.2,
    mesh: str = "",
    texture: str = "patches",
    texture_height: int = 16,
    albedo: str = "",
    shading: str = "smooth",
) -> Scene:
    """Shape `object` with a bitmap as its albedo, on a grey floor under a lamp and a constant sky.

    - `shape`: "duck", "sphere" or "displaced_sphere", centred at the origin; its longest side is `size`.
    - `mesh`: a mesh file that takes its place.
    - `texture`: "patches" of colours or "plain" grey, `texture_height` x twice as many texels.
    - `albedo`: an image file that takes its place.

    UVs are those of the file, or longitude and latitude. Raises ValueError for files that can't be read, and for other
    names.
    """
    check_choice("shape", shape, ROUND)
    check_choice("texture", texture, TEXTURES)
    check_choice("shading", shading, ("flat", "smooth"))
    made = load_mesh(mesh, shading=shading) if mesh else TARGET_SHAPES[shape](subdivisions)
    made = centred(made, size)
    made = made.smooth() if shading == "smooth" else made.flat()
    made = made if made.uvs is not None else spherical_uvs(made)
    if albedo:
        bitmap = Bitmap.from_file(albedo)
    else:
        bitmap = Bitmap(
            patches(texture_height) if texture == "patches" else np.full((texture_height, 2 * texture_height, 3), 0.5)
        )
    lamp = transformed(shapes.rectangle(1.5, 1.5), look_at((1.5, -1.0, 3.0), (0, 0, 0), (0, 0, 1)))
    return Scene(
        shapes={
            "object": Shape(made, TwoSided(Diffuse(bitmap))),
            "floor": _floor(),
            "lamp": Shape(lamp, Diffuse(0.0), AreaEmitter(5.0)),
        },
        camera=_camera((0.0, -3.2, 1.4), 28.0, 64),
        environment=ConstantEnvironment(0.4),
    )


def glossy_object(
    *,
    shape: str = "displaced_sphere",
    subdivisions: int = 4,
    size: float = 1.2,
    material: str = "Au",
    alpha: float = 0.2,
    sun: float = 60.0,
    sky_height: int = 32,
) -> Scene:
    """Shape `object` of rough metal, its roughness `alpha`, on a grey floor below a sky with a `sun`.

    The sky is an environment map of `sky_height` x twice as many texels (`procedural_sky`), with the zenith at +z.
    Raises ValueError as the parts do.
    """
    check_choice("shape", shape, ROUND)
    made = centred(TARGET_SHAPES[shape](subdivisions), size).smooth()
    up = np.eye(4)
    up[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # the map's +y is the world's +z
    return Scene(
        shapes={"object": Shape(made, TwoSided(RoughConductor(alpha, material))), "floor": _floor()},
        camera=_camera((0.0, -3.2, 1.8), 28.0, 64),
        environment=EnvironmentMap(procedural_sky(sky_height, sun), up),
    )


def still_life(*, resolution: int = 48, light: float = 25.0) -> Scene:
    """A ball, a box and a ring on a floor, seen by a camera and lit by the point light `lamp` and a faint sky.

    `resolution` is the image's width and height in pixels, `light` the lamp's intensity.
    """
    turned = np.eye(4)
    cosine, sine = math.cos(0.5), math.sin(0.5)
    turned[:2, :2] = [[cosine, -sine], [sine, cosine]]
    turned[:3, 3] = (0.65, 0.25, FLOOR + 0.3)
    lying = np.eye(4)
    lying[:3, 3] = (-0.1, -0.65, FLOOR + 0.13)
    parts = {
        "ball": (shapes.sphere(3, radius=0.4, center=(-0.55, 0.25, FLOOR + 0.4)).smooth(), (0.7, 0.3, 0.2)),
        "box": (transformed(shapes.box((0.5, 0.6, 0.6)), turned), (0.25, 0.55, 0.3)),
        "ring": (transformed(shapes.torus(0.3, 0.13, 32, 16), lying).smooth(), (0.3, 0.4, 0.75)),
    }
    return Scene(
        shapes={name: Shape(mesh, TwoSided(Diffuse(color))) for name, (mesh, color) in parts.items()}
        | {"floor": _floor()},
        camera=_camera((0.6, -3.0, 1.7), 40.0, resolution),
        environment=ConstantEnvironment(0.1),
        lights={"lamp": PointLight((1.2, -1.0, 1.8), light)},
    )


def star_light(*, resolution: int = 48, points: int = 5, radiance: float = 12.0) -> Scene:
    """A figure on a pedestal under `light`, a star with `points` tips that the camera does not see (Xu et al. 2023).

    Its tips show in the shadow alone. `resolution` is the image's width and height in pixels.
    """
    turned = np.eye(4)
    turned[:3, 3] = (0.0, 0.0, FLOOR + 0.75)
    figure = transformed(centred(shapes.duck(3), 0.9), turned)
    star = transformed(shapes.star(points, 0.6, 0.24), look_at((0.5, -0.4, 1.9), (0.0, 0.0, FLOOR), (0, 0, 1)))
    return Scene(
        shapes={
            "figure": Shape(figure, Diffuse((0.6, 0.55, 0.5))),
            "pedestal": Shape(shapes.box((0.5, 0.5, 0.4), (0.0, 0.0, FLOOR + 0.2)), Diffuse(0.5)),
            "light": Shape(star, Diffuse(0.0), AreaEmitter(radiance)),
            "floor": _floor(),
        },
        camera=_camera((0.0, -3.2, 1.6), 38.0, resolution),
    )


SCENES: dict[str, Callable[..., Scene]] = {
    "textured_object": textured_object,
    "glossy_object": glossy_object,
    "still_life": still_life,
    "star_light": star_light,
}


def load_scene(name: str, file: str, options: dict) -> Scene:
    """The scene in `file` (Mitsuba XML, where `options` set its variables, or glTF), or the procedural one of a name.

    Raises ValueError for what can't be built or read; messages start with the key.
    """
    if not file:
        try:
            return SCENES[name](**options)
        except (TypeError, ValueError) as problem:
            raise ValueError(f"options: {problem}") from None
    reader = load_gltf if is_gltf(file) else load_mitsuba
    try:
        return reader(file, **options)
    except (TypeError, ValueError) as problem:
        raise ValueError(f"file: {problem}") from None


def check_scene(name: str, options: dict) -> None:
    """Raise ValueError for an unknown scene, or an option that its function does not have."""
    check_choice("name", name, SCENES)
    check_options("options", SCENES[name], options, name)


def patches(height: int) -> Float[np.ndarray, "H W 3"]:
    """Smooth patches of three colours over longitude and latitude, `height` x twice as many texels."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    longitude, latitude = 2 * np.pi * u, np.pi * (0.5 - v)
    one = 0.5 + 0.5 * np.sin(3 * longitude) * np.cos(latitude)
    two = 0.5 + 0.5 * np.sin(5 * latitude + np.cos(longitude))
    colors = np.array([[0.85, 0.7, 0.1], [0.75, 0.2, 0.1], [0.15, 0.35, 0.6]])
    mixed = (1 - one)[..., None] * colors[0] + one[..., None] * colors[1]
    return (1 - 0.7 * two)[..., None] * mixed + (0.7 * two)[..., None] * colors[2]


def procedural_sky(height: int, sun: float) -> Float[np.ndarray, "H W 3"]:
    """Blue sky, brighter towards the horizon and the sun, above brown ground, `height` x twice as many texels.

    The sun is a disk about 20 degrees wide with soft borders, 40 degrees high, of radiance `sun`.
    """
    polar = np.pi * np.arange(height) / (height - 1)
    longitude = 2 * np.pi * (np.arange(2 * height) + 0.5) / (2 * height)
    polar, longitude = np.meshgrid(polar, longitude, indexing="ij")
    direction = np.stack([np.sin(polar) * np.sin(longitude), np.cos(polar), -np.sin(polar) * np.cos(longitude)], -1)
    elevation = math.radians(40)
    towards = direction @ (
        math.cos(elevation) * math.sin(2.0),
        math.sin(elevation),
        -math.cos(elevation) * math.cos(2.0),
    )
    up = direction[..., 1:2]
    sky = (
        np.array([0.25, 0.45, 0.9]) + 0.5 * np.exp(-4 * np.maximum(up, 0)) + 0.6 * np.exp(3 * (towards[..., None] - 1))
    )
    blend = 1 / (1 + np.exp(-20 * up))
    disk = np.exp(-((np.maximum(1 - towards, 0) / (1 - math.cos(math.radians(10)))) ** 2))[..., None]
    return blend * sky + (1 - blend) * np.array([0.25, 0.2, 0.15]) + sun * disk * np.array([1.0, 0.9, 0.75])


def _floor() -> Shape:
    return Shape(plane(20.0, center=(0.0, 0.0, FLOOR)), TwoSided(Diffuse(0.5)))


def _camera(origin, fov: float, resolution: int) -> Perspective:
    return Perspective(look_at(origin, (0.0, 0.0, -0.15), (0, 0, 1)), fov, Film(resolution, resolution))
