"""`GuidedEdges` beyond direct light, by every vertex of a blocker, in reverse mode, without any bias allowed for.

Both ends of its segments go on: to a panel that scatters the light of a lamp (the source's end), and from the floor to
a wall, which alone is in the picture (the detector's end).
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments import one_term
from jaxdr.transport.path_settings import PathSettings
from tests.gradients import floor_patch
from tests.gradients.floor_point import LIGHT, QUADRANGLE, RADIANCE, REFLECTANCE, UP, sheet
from tests.gradients.floor_point import scene as point_scene
from tests.gradients.lit_panel import lit_panel
from tests.references.polygon_shadow import irradiance_derivatives

BLOCKER = sheet(QUADRANGLE, 0.1)
FLOOR_SIZE = 0.5
WALL_Y, WALL_REFLECTANCE, FILM, FOV = -1.6, 0.5, 8, 40.0
# Lines from the wall past the blocker run beyond the light, and what the floor sends to the wall passes below.
WALL = np.array([[-0.5, WALL_Y, 0.25], [0.5, WALL_Y, 0.25], [0.5, WALL_Y, 1.05], [-0.5, WALL_Y, 1.05]])
CAMERA, TARGET = np.array([0.0, -0.6, 0.65]), np.array([0.0, WALL_Y, 0.65])
SETTINGS = PathSettings(3, True, "auto")


def wall_scene() -> jd.Scene:
    """A wall that floor and light shine on, past the blocker, and a camera that sees a patch of it."""
    under = point_scene(BLOCKER, FLOOR_SIZE)
    wall = jd.Shape(jd.Mesh(WALL, [[0, 2, 1], [0, 3, 2]]), jd.Diffuse(WALL_REFLECTANCE))
    camera = jd.Perspective(jd.look_at(CAMERA, TARGET, UP), FOV, jd.Film(FILM, FILM, jd.Box()))
    return jd.Scene(dict(under.shapes) | {"wall": wall}, camera)


def wall_exact(film: int = 5, nodes: int = 16) -> np.ndarray:
    """Derivative of the film's mean: that of the floor's radiance in closed form, gathered by quadrature."""
    to_world = np.asarray(jd.look_at(CAMERA, TARGET, UP), float)
    x, weight = np.polynomial.legendre.leggauss(film)
    half = np.tan(np.deg2rad(FOV) / 2)
    seen, share = [], []
    for i, j in np.ndindex(film, film):
        direction = to_world[:3, :3] @ [half * x[i], half * x[j], 1.0]
        seen.append(CAMERA + direction * (WALL_Y - CAMERA[1]) / direction[1])
        share.append(0.25 * weight[i] * weight[j])
    a, weight = np.polynomial.legendre.leggauss(nodes)
    a, weight = 0.5 * (a + 1), 0.5 * weight
    corners = FLOOR_SIZE * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    area2 = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    vertices = np.asarray(BLOCKER.vertices, float)
    outlines = [face for face in np.asarray(BLOCKER.faces) if np.all(vertices[face, 2] > 0)]
    pieces, total = [vertices[outline] for outline in outlines], np.zeros_like(vertices)
    for i, j in np.ndindex(nodes, nodes):
        far = (1 - a[j]) * corners[1] + a[j] * corners[2]
        point = (1 - a[i]) * corners[0] + a[i] * far
        gathered = 0.0
        for where, part in zip(seen, share, strict=True):
            offset = where - point
            squared = offset @ offset
            gathered += part * offset[2] * -offset[1] / squared**2  # both cosines over the squared distance
        gathered *= WALL_REFLECTANCE / np.pi * REFLECTANCE / np.pi * RADIANCE
        gathered *= area2 * a[i] * weight[i] * weight[j]
        for outline, found in zip(outlines, irradiance_derivatives(point, UP, LIGHT, pieces)[0], strict=True):
            np.add.at(total, outline, gathered * found)
    return total


@partial(jax.jit, static_argnames=("boundary", "count"))
def derivatives(of, boundary, count, keys):
    """From `count` segments of every strategy for each key."""
    vertices = jnp.asarray(of.parameters()["blocker.vertices"])
    moving = (True,) * len(of.shapes)
    prepared = boundary.prepare(one_term.context(of, moving, SETTINGS), jax.random.key(0))

    def mean(vertices, key):
        moved = one_term.context(of.replace({"blocker.vertices": vertices}), moving, SETTINGS)
        return one_term.image(boundary, moved, prepared, count // FILM**2, key).mean()

    return jax.lax.map(lambda key: jax.grad(mean)(vertices, key), keys)


def check(of, truth, boundary, count, calls=16):
    """Within 4.5 standard errors of so many calls, which are below 4 % of the largest entry."""
    scale = np.abs(truth).max()
    keys = jax.random.split(jax.random.key(1), calls)
    rows = np.asarray(derivatives(of, boundary, count, keys), float) / scale
    deviation = rows.std(0, ddof=1) / len(keys) ** 0.5
    assert deviation.max() < 0.04, deviation
    wrong = np.abs(rows.mean(0) - truth / scale)
    assert np.all(wrong < 4.5 * deviation + 1e-6), (rows.mean(0), deviation, truth / scale)


GUIDED = [
    pytest.param("kdtree", {"leaves": 256}, marks=pytest.mark.slow),
    pytest.param("grid", {"cells": (64, 4, 4), "guide_samples": 64}, marks=pytest.mark.slow),
    pytest.param("projective", {"leaves": 256}, marks=pytest.mark.slow),
    ("none", {}),
]


@pytest.mark.parametrize(("guide", "options"), GUIDED)
def test_light_that_the_source_scatters(guide, options):
    """The floor under a lit panel: no line ends on an emitter."""
    of = lit_panel(floor_patch.scene(BLOCKER))
    calls = 64 if guide == "projective" else 16
    check(of, floor_patch.exact(BLOCKER), jd.GuidedEdges(guide, "mis", **options), 1 << 16, calls)


@pytest.mark.parametrize(("guide", "options"), GUIDED)
def test_shadows_seen_on_a_wall(guide, options):
    """The floor is not in the picture: what its shadow takes away is light on the wall."""
    check(wall_scene(), wall_exact(), jd.GuidedEdges(guide, "mis", **options), 1 << 20, calls=24)
