"""Scenes of the matrix of borders. One compiled program has all borders of a kind: their values are data.

On the stage of surfaces every border of a material or a texture has a panel, and a few pixels, of its own. The panels
lie in one plane between two walls, so none of them changes what another one's pixels see. On the stage of lights all
lights shine on one floor, and one border at a time is looked at.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.emitters import Environment
from jaxdr.scene.ranges import Range
from tests.borders.registry import Border, borders, made, of_kind

SIDE = 2  # pixels of a panel, along a side
TILT = 0.3  # radians between the view and the panels' normal
DEPTHS = {"default": 3, "emitter": 3, "bidirectional": 2}  # light of one bounce has all of its ways to join paths
CORE = ("Diffuse", "Mask", "Phong", "Plastic", "RoughConductor", "ThinDielectric")  # of the default run of the tests
POINT = {"point": jd.PointLight((0.5, 1.0, 3.0), 40.0), "rear": jd.PointLight((-1.0, 0.5, -2.5), 40.0)}
LIGHTS = {
    "lamp": lambda: {"lamps": True},
    "sky": lambda: {"environment": jd.ConstantEnvironment((0.6, 0.7, 0.8))},
    "map": lambda: {"environment": made("EnvironmentMap", to_world=None)},
    "point": lambda: {"lights": POINT},
    "point and sky": lambda: {"lights": POINT, "environment": jd.ConstantEnvironment((0.6, 0.7, 0.8))},
}
INTEGRATORS = {
    "default": lambda depth: jd.PathTracer(depth),
    "emitter": lambda depth: jd.PathTracer(depth, sampling="emitter"),
    "bidirectional": lambda depth: jd.BidirectionalPathTracer(depth),
}


class Stage(NamedTuple):
    """A scene, its borders, and how the values of the borders get into the scene.

    - `paths`: parameter of the scene for every border; `masks`: the part of its array that is at the border.
    - `apart`: whether every border has pixels of its own.
    """

    scene: jd.Scene
    borders: list[Border]
    paths: list[str]
    masks: list[np.ndarray]
    apart: bool

    def at(self, values: jax.Array) -> jd.Scene:
        """The scene with the fields at these values [n]; NaN for what stays as it is."""
        known, new = self.scene.parameters(), {}
        for i, (path, mask) in enumerate(zip(self.paths, self.masks, strict=True)):
            now = new.get(path, known[path])
            new[path] = jnp.where(mask & ~jnp.isnan(values[i]), jnp.nan_to_num(values[i]), now)
        return self.scene.replace(new)

    def measure(self, integrator, spp: int) -> Callable:
        """Function of (values [n], direction [n], key): sums over the pixels of each border, and their derivatives."""

        def sums(values, key):
            image = jd.render(self.at(values), key, spp, integrator)
            weights = 0.5 + np.random.default_rng(0).random(image.shape)
            weighted = (image * weights).mean(-1)
            if not self.apart:
                return jnp.broadcast_to(weighted.mean(), (len(self.borders),))
            side = image.shape[0] // SIDE
            return weighted.reshape(side, SIDE, side, SIDE).mean((1, 3)).reshape(-1)[: len(self.borders)]

        return jax.jit(lambda values, direction, key: jax.jvp(lambda v: sums(v, key), (values,), (direction,)))


def _moves(border: Border) -> bool:
    """Whether the field turns a delta lobe: what is seen in it moves, and that has its own tests."""
    return (border.model, border.field) == ("Dielectric", "eta")


def surface_borders() -> list[Border]:
    """Of all materials and textures; the values of a texture are a reflectance."""
    materials = [border for name in of_kind(BSDF) for border in borders(name) if not _moves(border)]
    return materials + [border for name in of_kind(jd.Texture) for border in borders(name, Range(0.0, 1.0))]


def _material(name: str) -> BSDF:
    model = made(name)
    return jd.Diffuse(model) if isinstance(model, jd.Texture) else model


def _mask(border: Border, value: jax.Array) -> np.ndarray:
    """All of a field; of an image one row, so that black texels have neighbours that are not black."""
    mask = np.ones(value.shape, bool)
    if value.ndim == 3:
        mask[1:] = False
    return mask


@cache
def surfaces(light: str, models: tuple[str, ...] = ()) -> Stage:
    """A panel for every border of these materials and textures, or of all, under one kind of light."""
    found = [border for border in surface_borders() if not models or border.model in models]
    side = math.ceil(math.sqrt(len(found)))
    shapes, paths, masks = {}, [], []
    for i, border in enumerate(found):
        row, column = divmod(i, side)
        place = np.eye(4)
        # The camera looks down with y up, so that its left is -x of the world. It sees heights shortened.
        place[:2, 3] = (2 * column + 1) / side - 1, (1 - (2 * row + 1) / side) / math.cos(TILT)
        mesh = jd.shapes.transformed(jd.shapes.rectangle(1.6 / side, 1.6 / side / math.cos(TILT)), place)
        shapes[f"p{i}"] = jd.Shape(mesh, _material(border.model))
        inside = "reflectance." if isinstance(made(border.model), jd.Texture) else ""
        paths.append(f"p{i}.bsdf.{inside}{border.field}")
    for name, height in (("front", 4.0), ("back", -4.0)):
        pose = jd.look_at((0, 0, height), (0, 0, 0), (0, 1, 0))
        shapes[name] = jd.Shape(jd.shapes.transformed(jd.shapes.rectangle(6.0, 6.0), pose), jd.Diffuse((0.5, 0.4, 0.3)))
    more = LIGHTS[light]()
    if more.pop("lamps", False):
        for name, height in (("lamp", 3.0), ("rear_lamp", -3.0)):
            pose = jd.look_at((2.0, 1.5, height), (0, 0, 0), (0, 1, 0))
            mesh = jd.shapes.transformed(jd.shapes.rectangle(1.5, 1.5), pose)
            shapes[name] = jd.Shape(mesh, jd.Diffuse(0.0), jd.AreaEmitter((6.0, 5.0, 4.0)))
    eye = (0, -2.0 * math.sin(TILT), 2.0 * math.cos(TILT))
    pose, film = jd.look_at(eye, (0, 0, 0), (0, 1, 0)), jd.Film(SIDE * side, SIDE * side, jd.Box())
    view = jd.Orthographic(pose, film, far_clip=4.0)  # else it sees the back wall, which other panels light
    scene = jd.Scene(shapes, view, **more)
    masks = [_mask(border, scene.parameters()[path]) for border, path in zip(found, paths, strict=True)]
    return Stage(scene, found, paths, masks, True)


@cache
def lights(environment: str) -> Stage:
    """One light of every kind, with this environment, on a floor and a metal panel."""
    shapes = {
        "floor": jd.Shape(jd.shapes.plane(6.0), jd.Diffuse((0.5, 0.4, 0.3))),
        "panel": jd.Shape(
            jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((0, 0.8, 0.9), (0, -2, 1.5), (0, 0, 1))),
            jd.RoughConductor(0.4),
        ),
    }
    found, paths, members = [], [], {}
    lamps = {"AreaEmitter": made("AreaEmitter"), "other": jd.AreaEmitter(1.0)}
    for i, (name, emitter) in enumerate(lamps.items()):
        pose = jd.look_at((1.2 - 2.4 * i, -1, 2), (0, 0, 0), (0, 1, 0))
        mesh = jd.shapes.transformed(jd.shapes.rectangle(0.6, 0.6), pose)
        shapes[f"lamp{i}"] = jd.Shape(mesh, jd.Diffuse(0.0), emitter)
        if name != "other":
            found += borders(name)
            paths += [f"lamp{i}.emitter.{border.field}" for border in borders(name)]
    for name in of_kind(jd.DeltaLight):
        members[name] = made(name)
        found += (of_light := [b for b in borders(name) if b.field not in ("cutoff_angle", "beam_width")])
        paths += [f"{name}.{border.field}" for border in of_light]
    if environment in of_kind(Environment):
        found += borders(environment)
        paths += [f"environment.{border.field}" for border in borders(environment)]
    view = jd.Perspective(jd.look_at((0.0, -3, 2.0), (0, 0, 0.4), (0, 0, 1)), 35.0, jd.Film(8, 8, jd.Box()))
    scene = jd.Scene(shapes, view, made(environment), members)
    masks = [_mask(border, scene.parameters()[path]) for border, path in zip(found, paths, strict=True)]
    return Stage(scene, found, paths, masks, False)


class Program(NamedTuple):
    """One compiled program of the matrix: `light` is what shines on the surfaces, or the sky beside the lights."""

    kind: str
    light: str
    integrator: str

    @property
    def name(self) -> str:
        return f"{self.kind}, {self.light}, {self.integrator}"

    def stage(self) -> Stage:
        return surfaces(self.light) if self.kind == "surfaces" else lights(self.light)


LIGHTS_ALONE = ("lamp", "sky", "map", "point")
PROGRAMS = [Program("surfaces", light, integrator) for integrator in INTEGRATORS for light in LIGHTS_ALONE] + [
    Program("lights", sky, integrator) for integrator in INTEGRATORS for sky in of_kind(Environment)
]
