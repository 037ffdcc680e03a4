"""The scene of `floor_point` with a wider view: the film covers a patch of floor in the penumbra of the blocker.

Radiance and derivatives are those of single floor points, in closed form, averaged over the film by Gauss quadrature.
"""

import dataclasses
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from tests.gradients.floor_point import CAMERA, LIGHT, NAMES, POINT, RADIANCE, REFLECTANCE, UP, mean_and_error
from tests.gradients.floor_point import scene as point_scene
from tests.references.polygon_shadow import irradiance, irradiance_derivatives

FOV = 2.0  # degrees: about 0.3 units of floor across, and 0.8 in depth
FILM = 8
NODES = 12


def scene(blocker: jd.Mesh, floor_size: float = 2.0) -> jd.Scene:
    """Floor, light and blocker; the film lies on the floor, and nothing hides it from the camera."""
    of = point_scene(blocker, floor_size)
    camera = jd.Perspective(jd.look_at(CAMERA, POINT, UP), FOV, jd.Film(FILM, FILM, jd.Box()))
    return dataclasses.replace(of, camera=camera)


def exact(blocker: jd.Mesh) -> tuple[float, dict[str, np.ndarray]]:
    """Mean radiance of the film and its derivatives by name, for an open blocker over the floor."""
    vertices = np.asarray(blocker.vertices, float)
    outlines = [face for face in np.asarray(blocker.faces) if np.all(vertices[face, 2] > 0)]
    return _exact(tuple(map(tuple, vertices)), tuple(map(tuple, outlines)))


@cache
def _exact(vertices, outlines):
    vertices, outlines = np.array(vertices), [list(o) for o in outlines]
    pieces = [vertices[o] for o in outlines]
    to_world = np.asarray(jd.look_at(CAMERA, POINT, UP), float)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    total, d_blocker, d_light, d_height = 0.0, np.zeros_like(vertices), np.zeros_like(LIGHT), 0.0
    half = np.tan(np.deg2rad(FOV) / 2)
    for x, wx in zip(nodes, weights, strict=True):
        for y, wy in zip(nodes, weights, strict=True):
            direction = to_world[:3, :3] @ [half * x, half * y, 1.0]
            slide = -direction / direction[2] * -1.0
            point = CAMERA - direction * (CAMERA[2] / direction[2])
            share = 0.25 * wx * wy * REFLECTANCE / np.pi * RADIANCE
            total += share * irradiance(point, UP, LIGHT, pieces)
            d_pieces, d_lamp, d_point = irradiance_derivatives(point, UP, LIGHT, pieces)
            for outline, d_piece in zip(outlines, d_pieces, strict=True):
                np.add.at(d_blocker, outline, share * d_piece)
            d_light += share * d_lamp
            d_height += share * (d_point @ slide)
    return total, {"blocker.vertices": d_blocker, "light.vertices": d_light, "floor.height": d_height}


@partial(jax.jit, static_argnames=("boundary", "spp", "max_depth"))
def _estimate(of, values, key, boundary, spp, max_depth):
    def radiance(values):
        integrator = jd.PathTracer(max_depth=max_depth, boundary=boundary)
        return jnp.mean(jd.render(of.replace(values), key, spp=spp, integrator=integrator))

    return jax.value_and_grad(radiance)(values)


def estimates(of: jd.Scene, boundary, keys: int = 8, spp: int = 128, max_depth: int = 2):
    """Mean radiance [keys] and its reverse-mode derivatives {name: [keys, ...]}, for independent keys."""
    parameters = of.parameters()
    values = {name: jnp.asarray(parameters[name]) for name in NAMES}
    rows = [
        jax.device_get(_estimate(of, values, key, boundary, spp, max_depth))
        for key in jax.random.split(jax.random.key(0), keys)
    ]
    derivatives = {name: np.stack([row[1][name] for row in rows]).astype(float) for name in values}
    floor = derivatives.pop("floor.vertices")
    return np.array([row[0] for row in rows], float), derivatives | {"floor.height": floor[..., 2].sum(-1)}


def errors(blocker: jd.Mesh, boundary, **settings) -> tuple[np.ndarray, np.ndarray]:
    """(errors of all derivatives, their standard errors), relative to the largest one of the blocker's."""
    _, truth = exact(blocker)
    _, rows = estimates(scene(blocker), boundary, **settings)
    scale = np.max(np.abs(truth["blocker.vertices"]))
    wrong, deviation = [], []
    for name, true in truth.items():
        mean, error = mean_and_error(rows[name] / scale)
        wrong.append(np.ravel(mean - true / scale))
        deviation.append(np.ravel(error))
    return np.concatenate(wrong), np.concatenate(deviation)
