"""Twelve triangles that share no vertices, whatever they form; meshes that are open and not manifold."""

import warnings

import numpy as np

import jaxdr as jd
from jaxdr.geometry import shapes
from tests.stability.case import Case
from tests.stability.shadows import ALONG, BOTH, HIGH, LACKING, SHADE
from tests.stability.stage import TURN, cube, placed, rotation, table
from tests.stability.stage import camera as view

TRIANGLES = 12
LARGE = np.array([[-0.45, -0.3, 0.0], [0.5, -0.25, 0.0], [0.05, 0.5, 0.0]])
APART = rotation((0, 0, 1), 2.0)


def soup(*triangles) -> jd.Mesh:
    """Triangles [3, 3] as a mesh without shared vertices, filled up with small ones far below the floor."""
    count = TRIANGLES - len(triangles)
    spare = 0.01 * LARGE + np.stack([np.arange(count), 0 * np.arange(count), np.full(count, -5.0)], 1)[:, None]
    points = np.concatenate([np.reshape(triangles, (-1, 3)), spare.reshape(-1, 3)])
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Mesh: .* edges lie on others")  # that is what these are about
        return jd.Mesh(points, np.arange(len(points)).reshape(-1, 3))


def corners(mesh: jd.Mesh) -> np.ndarray:
    """Of every face [F, 3, 3]."""
    return np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)]


def each(*velocities) -> np.ndarray:
    """Velocities of the first triangles; the others stay."""
    found = np.zeros((TRIANGLES, 3, 3))
    for i, velocity in enumerate(velocities):
        found[i] = velocity
    return found.reshape(-1, 3)


def case(name, about, source, mesh, velocity, in_view=False, **options) -> Case:
    """The triangles move; their shadow is in view, or they are as well."""
    scene = table(mesh, view=None if in_view else view(*SHADE, 45.0))
    return Case(name, "meshes", about, source, scene, {"blocker.vertices": velocity}, 0.02, **options)


def cases() -> list[Case]:
    """Soups first: two structures, with edges on one another and without."""
    whole = corners(cube())
    flipped = np.array([t[::-1] if i % 3 == 0 else t for i, t in enumerate(whole)])
    low, high = LARGE + HIGH, LARGE @ APART.T + (0.15, -0.1, 1.3)
    beside = LARGE @ APART.T + (0.1, 0.15, 1.0)
    tilted = LARGE @ rotation((1.0, 0.2, 0.3), 0.9).T + HIGH
    one, two = (1.0, 0.2, 0.0), (-0.3, 0.9, 0.1)
    return [
        case(
            "split_vertices",
            "a cube of twelve triangles that share no vertex",
            "Mitsuba issue 1895: the visible boundary of a cube is 2.7 times too large",
            soup(*whole),
            np.asarray(ALONG),
            True,
            expected=LACKING,
        ),
        case(
            "flipped",
            "the same, every third triangle turned over",
            "inconsistent orientation of imported meshes (own list)",
            soup(*flipped),
            np.asarray(ALONG),
            True,
            expected=LACKING,
        ),
        case(
            "crossing_boundaries",
            "shadows of two triangles at different heights cross, and move in different directions",
            "a continuous velocity cannot equal both where they cross (docs/warped_area.md)",
            soup(low, high),
            each(one, two),
            expected=BOTH,
        ),
        case(
            "coplanar",
            "two triangles overlap in one plane and slide over each other",
            "z-fighting, edges that lie on another face (own list)",
            soup(low, beside),
            each(one, (-0.3, 0.9, 0.0)),
            expected=BOTH,
        ),
        case(
            "duplicated",
            "every triangle is there twice",
            "duplicate faces of imported meshes (own list)",
            soup(low, low, high, high),
            each(one, one, two, two),
            expected=BOTH,
        ),
        case(
            "crossing_triangles",
            "two triangles that pierce each other; their shadows alone are seen",
            "interpenetrating meshes (docs/line_sampling.md guarantees their shadows)",
            soup(low, tilted),
            each(one, two),
            expected=BOTH,
        ),
        open_box(),
    ]


def open_box() -> Case:
    """A box without lid, and a fin at one of its edges, where three faces meet."""
    box = shapes.box()
    points, faces = np.asarray(box.vertices, float), np.asarray(box.faces)
    top = (points[faces][:, :, 2] > 0).all(1)
    rim = [i for i in range(len(points)) if points[i, 1] > 0 and points[i, 0] > 0]
    points = np.vstack([points, [[1.1, 1.0, 0.2]]])
    mesh = jd.Mesh(points, np.vstack([faces[~top], [[*rim, len(points) - 1]]]))
    return case(
        "open_non_manifold",
        "a box without lid, and a fin: open edges, and one edge with three faces",
        "code that expects two faces at every edge (redner issue 122: edge sampling hangs or crashes)",
        placed(mesh, TURN, (0.0, 0.0, 0.6), 0.5),
        np.asarray(ALONG),
        True,
        expected=BOTH,
    )
