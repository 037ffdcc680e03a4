"""Small scenes of the study: a Cornell box, a body of rough glass, caustics, an environment map."""

import numpy as np

import jaxdr as jd
from jaxdr.geometry.shapes import box, rectangle, sphere, transformed

UP = [0, 0, 1]
SIZE = 48


def _camera(at, target, fov):
    return jd.Perspective(jd.look_at(at, target, UP), fov, jd.Film(SIZE, SIZE, jd.Gaussian()))


def _facing_down(size, at):
    matrix = np.array([[1, 0, 0, at[0]], [0, -1, 0, at[1]], [0, 0, -1, at[2]], [0, 0, 0, 1.0]])
    return transformed(rectangle(size, size), matrix)


def _lamp(size, at, power):
    """A square lamp of the same power whatever its size."""
    return jd.Shape(_facing_down(size, at), jd.Diffuse(0.0), jd.AreaEmitter(power / size**2))


def _wall(corners, reflectance):
    return jd.Shape(jd.Mesh(corners, [[0, 1, 2], [0, 2, 3]]), jd.TwoSided(jd.Diffuse(reflectance)))


def _box_walls():
    grey, red, green = (0.7, 0.7, 0.7), (0.6, 0.1, 0.1), (0.1, 0.5, 0.1)
    return {
        "floor": _wall([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], grey),
        "ceiling": _wall([[-1, -1, 2], [-1, 1, 2], [1, 1, 2], [1, -1, 2]], grey),
        "back": _wall([[-1, 1, 0], [1, 1, 0], [1, 1, 2], [-1, 1, 2]], grey),
        "left": _wall([[-1, -1, 0], [-1, 1, 0], [-1, 1, 2], [-1, -1, 2]], red),
        "right": _wall([[1, -1, 0], [1, -1, 2], [1, 1, 2], [1, 1, 0]], green),
    }


def _body(mesh, bsdf, smooth=True):
    mesh = jd.Mesh(mesh.vertices, mesh.faces, normal_faces=mesh.faces if smooth else None)
    return {"body": jd.Shape(mesh, bsdf)}


def cornell():
    """Two diffuse bodies in a box, a lamp at the ceiling."""
    bodies = _body(sphere(3, 0.35, (-0.4, 0.2, 0.35)), jd.Diffuse(0.7))
    bodies["box"] = jd.Shape(box((0.5, 0.5, 1.0), (0.4, 0.4, 0.5)), jd.Diffuse(0.7))
    return jd.Scene(
        _box_walls() | bodies | {"lamp": _lamp(0.5, (0, 0, 1.98), 4.0)}, _camera([0, -3.6, 1], [0, 0, 1], 36)
    )


def hidden_lamp():
    """The same box. Its lamp is behind a screen, so that the light reaches only the ceiling directly."""
    lamp = jd.Shape(
        transformed(rectangle(0.3, 0.3), np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1.4], [0, 0, 0, 1.0]]))
    )
    lamp = jd.Shape(lamp.mesh, jd.Diffuse(0.0), jd.AreaEmitter(60.0))
    screen = jd.Shape(rectangle(0.9, 0.9, (0, 0, 1.35)), jd.TwoSided(jd.Diffuse(0.5)))
    bodies = _body(sphere(3, 0.35, (-0.4, 0.2, 0.35)), jd.Diffuse(0.7))
    return jd.Scene(_box_walls() | bodies | {"lamp": lamp, "screen": screen}, _camera([0, -3.6, 1], [0, 0, 1], 36))


def rough_glass():
    """A body of rough glass in the box."""
    body = _body(sphere(3, 0.5, (0, 0, 0.7)), jd.RoughDielectric(0.1, 1.5))
    return jd.Scene(_box_walls() | body | {"lamp": _lamp(0.5, (0, 0, 1.98), 4.0)}, _camera([0, -3.6, 1], [0, 0, 1], 36))


def caustic():
    """A small lamp above a ball of smooth glass over a diffuse floor. Only the caustic in its shadow is in view."""
    body = _body(sphere(4, 0.5, (0, 0, 1.0)), jd.Dielectric(1.5))
    floor = jd.Shape(rectangle(6.0, 6.0), jd.Diffuse(0.6))
    return jd.Scene(
        body | {"floor": floor, "lamp": _lamp(0.2, (0.8, 0.3, 3.0), 6.0)},
        _camera([-0.4, -1.2, 0.9], [-0.4, -0.15, 0.0], 36),
    )


def mirror_caustic():
    """A ring of metal on a diffuse floor, a small lamp beside."""
    angle = np.linspace(0, 2 * np.pi, 97)[:-1]
    ring = np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), 0 * angle], -1)
    vertices = np.concatenate([ring, ring + np.array([0, 0, 0.4])])
    i, j = np.arange(96), (np.arange(96) + 1) % 96
    faces = np.concatenate([np.stack([i, j, j + 96], -1), np.stack([i, j + 96, i + 96], -1)])
    body = _body(jd.Mesh(vertices, faces), jd.TwoSided(jd.Conductor("Al")))
    floor = jd.Shape(rectangle(6.0, 6.0), jd.Diffuse(0.6))
    return jd.Scene(
        body | {"floor": floor, "lamp": _lamp(0.15, (1.4, 0.5, 2.0), 3.0)}, _camera([-0.3, -1.6, 1.9], [0, 0, 0], 45)
    )


def environment():
    """A ball of smooth glass and one of metal on a floor, under a map with a small sun."""
    sky = np.full((32, 64, 3), 0.3) * [0.6, 0.8, 1.0]
    sky[8:10, 40:42] = 250.0
    bodies = _body(sphere(3, 0.5, (-0.55, 0, 0.5)), jd.Dielectric(1.5))
    bodies |= {"metal": jd.Shape(sphere(3, 0.5, (0.55, 0.2, 0.5)), jd.RoughConductor(0.15, "Cu"))}
    floor = jd.Shape(rectangle(4.0, 4.0), jd.Diffuse(0.5))
    turned = np.eye(4)[[0, 2, 1, 3]]  # the map's y is up
    camera = _camera([0, -4.0, 1.8], [0, 0, 0.3], 32)
    return jd.Scene(bodies | {"floor": floor}, camera, jd.EnvironmentMap(sky, turned))


SCENES = {  # and the longest paths, in segments
    "cornell": (cornell, 5),
    "hidden_lamp": (hidden_lamp, 5),
    "rough_glass": (rough_glass, 5),
    "caustic": (caustic, 4),
    "mirror_caustic": (mirror_caustic, 4),
    "environment": (environment, 5),
}
