"""The scene of `floor_point` with a wider view: the film covers a patch of floor in the penumbra of the blocker.

Derivatives by the blocker's vertices, which are all boundary term, are those of single floor points, in closed form,
averaged over the film by Gauss quadrature.
"""

import dataclasses
from functools import cache

import numpy as np

import jaxdr as jd
from tests.gradients.floor_point import CAMERA, LIGHT, POINT, RADIANCE, REFLECTANCE, UP
from tests.gradients.floor_point import scene as point_scene
from tests.references.polygon_shadow import irradiance_derivatives

FOV = 6.0  # degrees: about 0.8 units of floor across, and 2.5 in depth
FILM = 8
NODES = 24


def scene(blocker: jd.Mesh, light=LIGHT, fov: float = FOV) -> jd.Scene:
    """Floor, light and blocker; the film lies on the floor, and nothing hides it from the camera."""
    of = point_scene(blocker, 4.0, light)
    camera = jd.Perspective(jd.look_at(CAMERA, POINT, UP), fov, jd.Film(FILM, FILM, jd.Box()))
    return dataclasses.replace(of, camera=camera)


def exact(blocker: jd.Mesh, light=LIGHT, fov: float = FOV, nodes: int = NODES) -> np.ndarray:
    """Derivative of the film's mean by the vertices of an open blocker over the floor; smaller lights need more nodes.

    `nodes` of the quadrature along each side of the film.
    """
    vertices = np.asarray(blocker.vertices, float)
    outlines = [face for face in np.asarray(blocker.faces) if np.all(vertices[face, 2] > 0)]
    return _exact(tuple(map(tuple, vertices)), tuple(map(tuple, outlines)), tuple(map(tuple, light)), fov, nodes)


@cache
def _exact(corners, faces, light, fov, count):
    vertices, outlines, light = np.array(corners), [list(face) for face in faces], np.array(light)
    pieces = [vertices[outline] for outline in outlines]
    to_world = np.asarray(jd.look_at(CAMERA, POINT, UP), float)
    nodes, weights = np.polynomial.legendre.leggauss(count)
    half, total = np.tan(np.deg2rad(fov) / 2), np.zeros_like(vertices)
    for x, weight_x in zip(nodes, weights, strict=True):
        for y, weight_y in zip(nodes, weights, strict=True):
            direction = to_world[:3, :3] @ [half * x, half * y, 1.0]
            point = CAMERA - direction * (CAMERA[2] / direction[2])
            share = 0.25 * weight_x * weight_y * REFLECTANCE / np.pi * RADIANCE
            for outline, derivative in zip(outlines, irradiance_derivatives(point, UP, light, pieces)[0], strict=True):
                np.add.at(total, outline, share * derivative)
    return total
