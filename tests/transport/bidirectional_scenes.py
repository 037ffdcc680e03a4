"""Scenes of bidirectional path tracing: small, of all kinds of emitters, cameras and BSDFs."""

import numpy as np

import jaxdr as jd
from jaxdr.geometry.shapes import box, rectangle, sphere, transformed

UP = [0, 0, 1]


def inside_out(mesh: jd.Mesh) -> jd.Mesh:
    return jd.Mesh(mesh.vertices, np.asarray(mesh.faces)[:, ::-1])


def facing_down(width: float, height: float, at) -> jd.Mesh:
    matrix = np.array([[1, 0, 0, at[0]], [0, -1, 0, at[1]], [0, 0, -1, at[2]], [0, 0, 0, 1.0]])
    return transformed(rectangle(width, height), matrix)


def lamp(at=(0.1, 0.0, 1.9), size=0.6, radiance=8.0) -> jd.Shape:
    return jd.Shape(facing_down(size, size, at), jd.Diffuse(0.2), jd.AreaEmitter(radiance))


def camera(size=8, fov=50.0, at=(0.2, -1.8, 0.9), target=(0, 0, 0.7), film_filter=None):
    film = jd.Film(size, size, film_filter or jd.Box())
    return jd.Perspective(jd.look_at(at, target, UP), fov, film)


def room() -> dict[str, jd.Shape]:
    """Walls around 4 x 4 x 2, seen from within."""
    return {"room": jd.Shape(inside_out(box((4.0, 4.0, 2.0), (0.0, 0.0, 1.0))), jd.Diffuse((0.7, 0.5, 0.4)))}


def floor() -> dict[str, jd.Shape]:
    return {"floor": jd.Shape(rectangle(4.0, 4.0), jd.TwoSided(jd.Diffuse((0.3, 0.5, 0.7))))}


def ball(bsdf, at=(0.0, 0.2, 0.6), radius=0.45, smooth=True) -> dict[str, jd.Shape]:
    """A sphere with texture coordinates, interpolated normals where `smooth`."""
    mesh = sphere(2, radius, at)
    uvs = np.asarray(mesh.vertices)[:, :2]
    mesh = jd.Mesh(mesh.vertices, mesh.faces, uvs=uvs, uv_faces=mesh.faces, normal_faces=mesh.faces if smooth else None)
    return {"ball": jd.Shape(mesh, bsdf)}


def zoo() -> dict[str, jd.Shape]:
    """Balls of many kinds."""
    bumps = jd.Bitmap(BUMPS)
    kinds = [
        jd.Plastic((0.5, 0.2, 0.2)),
        jd.TwoSided(jd.Mask(0.6, jd.Diffuse(0.7))),
        jd.ThinDielectric(1.5),
        jd.NormalMap(bumps, jd.Plastic(0.5)),
        jd.Principled(0.6, 0.3, 0.4),
        jd.Dielectric(1.5),
    ]
    places = [(-0.6, 0.2, 0.4), (0.0, 0.6, 0.5), (0.6, 0.2, 0.4), (-0.3, -0.3, 1.0), (0.3, -0.2, 1.0), (0.1, -0.5, 0.4)]
    return {f"{i}": ball(kinds[i], places[i], 0.3)["ball"] for i in range(len(kinds))}


def textured_lamp() -> jd.Shape:
    mesh = facing_down(1.2, 1.2, (0.1, 0.0, 1.8))
    uvs = np.asarray(mesh.vertices)[:, :2] / 1.2
    glow = jd.Bitmap(np.random.default_rng(1).uniform(0.0, 6.0, (4, 5, 3)))
    mesh = jd.Mesh(mesh.vertices, mesh.faces, uvs=uvs, uv_faces=mesh.faces)
    return jd.Shape(mesh, jd.Diffuse(0.5), jd.AreaEmitter(glow))


def picture(height=6, width=12):
    values = np.random.default_rng(2).uniform(0.1, 0.5, (height, width, 3))
    values[1, 4] = 12.0
    return values


SKY = jd.EnvironmentMap(picture())
LIGHTS = {
    "point": jd.PointLight([0.8, -0.5, 1.5], (1.5, 1.0, 0.5)),
    "spot": jd.SpotLight([-0.9, -0.6, 1.6], [0.8, 0.7, -1.2], (3.0, 4.0, 5.0), 35.0, 15.0),
    "far": jd.DirectionalLight([0.4, 0.5, -1.0], 0.7),
    "slides": jd.Projector(
        np.random.default_rng(3).uniform(0.2, 1.5, (3, 4, 3)), jd.look_at([0, -1, 1.7], [0, 0.3, 0.3], UP), 50.0
    ),
}
BUMPS = np.random.default_rng(4).uniform([0.4, 0.4, 0.9], [0.6, 0.6, 1.0], (5, 5, 3))


def scenes() -> dict:
    """Functions that make the scenes, by name, with the depth to compare them at.

    Without lights that have no area where there are delta lobes: of their caustics the path tracer sees nothing.
    """
    sky, dim = jd.ConstantEnvironment((0.4, 0.5, 0.6)), jd.ConstantEnvironment(0.3)
    thin = jd.ThinLens(jd.look_at([0.2, -1.8, 0.9], [0, 0, 0.6], UP), 50.0, jd.Film(8, 8, jd.Gaussian()), 0.1, 2.0)
    across = jd.look_at([0.3, -1.7, 1.4], [0, 0, 0.6], UP) @ np.diag([0.9, 0.9, 1.0, 1.0])
    parallel = jd.Orthographic(across, jd.Film(8, 8, jd.Tent()))
    bumpy, shine = (ball(jd.NormalMap(jd.Bitmap(BUMPS), bsdf)) for bsdf in (jd.RoughConductor(0.3), jd.Plastic(0.5)))
    return {
        "zoo": (lambda: jd.Scene(floor() | zoo() | {"lamp": textured_lamp()}, thin, SKY), 4),
        "room": (lambda: jd.Scene(room() | ball(jd.Diffuse(0.8)) | {"lamp": lamp()}, camera()), 4),
        "principled": (
            lambda: jd.Scene(room() | ball(jd.Principled(0.6, 0.3, 0.4)) | {"lamp": textured_lamp()}, camera()),
            4,
        ),
        "rough_glass": (lambda: jd.Scene(room() | ball(jd.RoughDielectric(0.3, 1.5)) | {"lamp": lamp()}, camera()), 4),
        "glass": (
            lambda: jd.Scene(room() | ball(jd.Dielectric(1.5), smooth=False) | {"lamp": lamp(size=1.0)}, camera()),
            5,
        ),
        "smooth_glass": (lambda: jd.Scene(room() | ball(jd.Dielectric(1.5)) | {"lamp": lamp(size=1.0)}, camera()), 5),
        "mirror": (lambda: jd.Scene(floor() | ball(jd.Conductor("Al")) | {"lamp": lamp(size=1.0)}, camera(), dim), 4),
        "plastic": (lambda: jd.Scene(floor() | ball(jd.Plastic((0.5, 0.2, 0.2))) | {"lamp": lamp()}, camera(), sky), 4),
        "mask": (lambda: jd.Scene(floor() | ball(jd.TwoSided(jd.Mask(0.6, jd.Diffuse(0.7)))), camera(), sky), 4),
        "pane": (lambda: jd.Scene(floor() | ball(jd.ThinDielectric(1.5)) | {"lamp": lamp(size=1.0)}, camera()), 5),
        "map": (lambda: jd.Scene(floor() | ball(jd.RoughConductor(0.2)), camera(), SKY), 4),
        "sky_glass": (lambda: jd.Scene(floor() | ball(jd.RoughDielectric(0.2, 1.5)), camera(), SKY), 4),
        "lights": (lambda: jd.Scene(floor() | ball(jd.RoughPlastic(0.5)), camera(), None, LIGHTS), 4),
        "lights_and_sky": (
            lambda: jd.Scene(floor() | ball(jd.RoughDielectric(0.3, 1.4)) | {"lamp": lamp()}, camera(), SKY, LIGHTS),
            4,
        ),
        "lens": (lambda: jd.Scene(room() | ball(jd.Diffuse(0.8)) | {"lamp": lamp()}, thin), 4),
        "parallel": (lambda: jd.Scene(floor() | ball(jd.RoughConductor(0.3)) | {"lamp": lamp()}, parallel, dim), 4),
        "bumpy": (lambda: jd.Scene(floor() | bumpy, camera(), SKY, {"point": LIGHTS["point"]}), 4),
        "shine": (lambda: jd.Scene(floor() | shine | {"lamp": lamp()}, camera(), sky), 4),
    }
