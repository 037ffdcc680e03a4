"""Textured area emitters against exact numbers: a floor point under a light that varies, behind a rectangle.

Light and blocker move and stretch (the texture goes along), the floor is raised, texels change.
"""

import numpy as np
import pytest

import jaxdr as jd
from tests.gradients.floor_point import (
    CAMERA,
    LIGHT,
    POINT,
    REFLECTANCE,
    RELATIVE_RADIUS,
    estimates,
    mean_and_error,
    scene,
    sheet,
)
from tests.references.textured_light import Level, bilinear, texel_irradiances, two_triangles

LAMP, SHADE = Level(-1.5, -1.5, 1.5, 1.5, 1.2), Level(-0.35, -0.3, 0.45, 0.2, 0.6)
CORNERS = np.array([[SHADE.x0, SHADE.y0], [SHADE.x1, SHADE.y0], [SHADE.x1, SHADE.y1], [SHADE.x0, SHADE.y1]])
BLOCKER = np.insert(CORNERS, 2, SHADE.z, axis=1)
RNG = np.random.default_rng(3)
# Dark next to bright, and black: where a path meets nothing, the boundary may glow.
PIXELS = RNG.choice([0.0, 0.5, 6.0], (4, 5, 1)) * RNG.uniform(0.5, 1.0, (4, 5, 3))
COLORS = np.array([[0.0, 0.1, 0.2], [6.0, 5.0, 4.0], [0.3, 0.2, 0.1], [2.0, 3.0, 4.0]])
STEP = 1e-4
SLIDE = (CAMERA - POINT) / (CAMERA - POINT)[2]  # of the point, along the camera ray, when the floor is raised
KERNEL = jd.KernelDensity(RELATIVE_RADIUS, capacity=1.0)
TEXELS = {"pixels": (jd.Bitmap(PIXELS, wrap="clamp"), bilinear(*PIXELS.shape[:2])),
          "colors": (jd.VertexColors(COLORS), two_triangles())}  # fmt: skip
ESTIMATORS = [pytest.param(KERNEL, id="kernel"), pytest.param(jd.LineSampling(), id="lines")]


def lamp(texture, cells=1):
    """The light, of `cells`² squares of two triangles."""
    share = np.linspace(0, 1, cells + 1)
    uvs = np.stack(np.meshgrid(share, share, indexing="ij"), -1).reshape(-1, 2)
    points = LIGHT[0] + np.insert(3.0 * uvs, 2, 0.0, axis=1)
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    v00, v10, v01, v11 = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel()
    if cells == 1:  # the corners in the order of the reference
        points, uvs, (v00, v10, v01, v11) = points[[0, 1, 3, 2]], uvs[[0, 1, 3, 2]], np.array([[0], [3], [1], [2]])
    faces = np.concatenate([np.stack([v00, v01, v11], 1), np.stack([v00, v11, v10], 1)])
    return jd.Shape(jd.Mesh(points, faces, uvs, faces), jd.Diffuse(0.0), jd.AreaEmitter(texture))


def exact(texture, values):
    """(radiance, its derivatives by texels and by what `motions` lists), mean over channels."""

    def irradiances(moved):
        light, blocker = Level(*(LAMP + moved[:5])), Level(*(SHADE + moved[5:10]))
        return texel_irradiances(POINT + moved[10] * SLIDE, light, blocker, texture)

    scale, grey = REFLECTANCE / np.pi, values.mean(-1).ravel()
    moves = [irradiances(s * STEP * axis) @ grey for axis in np.eye(11) for s in (1, -1)]
    slopes = -np.diff(np.reshape(moves, (11, 2)))[:, 0] / (2 * STEP)
    at_rest = irradiances(np.zeros(11))
    return scale * at_rest @ grey, scale * at_rest, scale * slopes


def motions(light, blocker, rows):
    """Estimates [keys, 11] of the derivatives by the sides and heights of light and blocker, and the floor's height."""
    columns = []
    for name, mesh, level in (("light", light, LAMP), ("blocker", blocker, SHADE)):
        points, slopes = np.asarray(mesh.vertices), rows[f"{name}.vertices"]
        level_points = np.abs(points[:, 2] - level.z) < 1e-6
        for side in range(4):
            axis, other = side % 2, level[(side + 2) % 4]
            moved = np.where(level_points, (points[:, axis] - other) / (level[side] - other), 0.0)
            columns.append(slopes[..., axis] @ moved)
        columns.append(slopes[..., 2] @ level_points)
    return np.stack([*columns, rows["floor.height"]], 1)


def check(kind, boundary, cells=1, tolerance=0.001, radius=0.5, keys=6, spp=32, noise=0.03):
    texture, reference = TEXELS[kind]
    values, blocker = np.asarray(getattr(texture, kind), float), sheet(BLOCKER, radius)
    radiance, by_texel, by_motion = exact(reference, values)
    light, name = lamp(texture, cells), f"light.emitter.radiance.{kind}"
    of = scene(blocker)
    of = jd.Scene(dict(of.shapes) | {"light": light}, of.camera)
    found, rows = estimates(of, boundary, keys, spp, sampling="mis", more=(name,))
    mean, error = mean_and_error(found)
    assert abs(mean - radiance) < 4 * error + 1e-4 * radiance, (mean, error, radiance)
    # By texels each channel has a third of the mean.
    by_texels = 3 * rows[name].reshape(keys, -1, 3).mean(-1), by_texel
    for (estimate, true), small in ((by_texels, 1e-4), ((motions(light.mesh, blocker, rows), by_motion), tolerance)):
        largest = np.abs(true).max()
        mean, error = (x / largest for x in mean_and_error(estimate))
        assert error.max() < noise, error
        assert np.all(np.abs(mean - true / largest) < 4.5 * error + small), np.stack([mean, error, true / largest], 1)


@pytest.mark.parametrize("boundary", ESTIMATORS)
def test_every_derivative_is_that_of_quadrature(boundary):
    check("pixels", boundary)


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ESTIMATORS)
def test_colours_of_vertices(boundary):
    """The colours of two triangles do not continue each other: boundary points have to find their face."""
    check("colors", boundary)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("boundary", "tolerance"),
    [pytest.param(KERNEL, 0.02, id="kernel"), pytest.param(jd.LineSampling(), 0.001, id="lines")],
)
def test_many_triangles(boundary, tolerance):
    """Kernels go on over the plane of a small face, with the radiance of its border; chords are short, and noisy."""
    check("pixels", boundary, 6, tolerance, radius=0.1, spp=128, noise=0.12)
