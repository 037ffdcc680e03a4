"""Meshes, rays and float64 references for the tests of the ray queries."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.geometry import shapes

EPS = float(np.finfo(np.float32).eps)
FAR = np.float32(1e30)


def affine(scale=1.0, offset=(0.0, 0.0, 0.0), seed=None) -> np.ndarray:
    """Scale (one number or three), then a random rotation when a seed is given, then an offset."""
    matrix = np.eye(4)
    rotation = np.eye(3) if seed is None else np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    matrix[:3, :3] = rotation @ np.diag(np.broadcast_to(scale, 3))
    matrix[:3, 3] = offset
    return matrix


FAR_AWAY = (1000.0, -1000.0, 1000.0)
MESHES = {
    "sphere": (lambda: shapes.sphere(2), affine()),
    "sphere, tiny": (lambda: shapes.sphere(2), affine(1e-3)),
    "sphere, far away": (lambda: shapes.sphere(2), affine(1.0, FAR_AWAY)),
    "sphere, flattened": (lambda: shapes.sphere(2), affine((1.0, 1.0, 0.05), seed=1)),
    "sphere, fine": (lambda: shapes.sphere(vertex_count=2500), affine(2.0, (0.3, 0.2, 0.1), seed=2)),
    "bumps": (lambda: shapes.displaced_sphere(3), affine(seed=3)),
    "bumps, tiny": (lambda: shapes.displaced_sphere(3), affine(1e-3, (1e-3, 0.0, 0.0), seed=4)),
    "bumps, far away": (lambda: shapes.displaced_sphere(3), affine(10.0, FAR_AWAY)),
    "box": (lambda: shapes.box(), affine()),
    "box, rotated": (lambda: shapes.box((1.0, 2.0, 3.0)), affine(0.5, (1.0, 0.0, 0.0), seed=5)),
    "box, mirrored": (lambda: shapes.box(), affine((-1.0, 1.0, 2.0))),
    "rectangle": (lambda: shapes.rectangle(2.0, 1.0), affine()),
    "plane": (lambda: shapes.plane(4.0, 20), affine(1.0, (0.0, 0.0, -0.2), seed=6)),
    "star": (lambda: shapes.star(7), affine(seed=7)),
    "torus": (lambda: shapes.torus(1.0, 0.4, 32, 16), affine()),
    "torus, far away": (lambda: shapes.torus(1.0, 0.4, 32, 16), affine(100.0, FAR_AWAY, seed=8)),
    "trefoil": (lambda: shapes.trefoil_tube(segments=96, sides=8), affine()),
    "trefoil, tiny": (lambda: shapes.trefoil_tube(segments=96, sides=8), affine(1e-3, seed=9)),
    "pawn": (lambda: shapes.pawn(16), affine()),
    "cone": (lambda: shapes.revolved([(0.0, 1.0), (1.0, 0.0)], 24), affine((1.0, 2.0, 1.0), (5.0, 5.0, 5.0), seed=10)),
}


def make(name: str) -> jd.Mesh:
    """One of `MESHES`."""
    build, matrix = MESHES[name]
    return shapes.transformed(build(), matrix)


def arrays(mesh: jd.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (float32) and faces on the host."""
    return np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces)


def ask(query, *arguments, **options):
    """A query on host arrays, answered in host arrays; compiled once for all arguments of the same shapes."""
    return jax.tree.map(np.asarray, _compiled(query, **options)(*jax.tree.map(jnp.asarray, arguments)))


@cache
def _compiled(query, **options):
    return jax.jit(partial(query, **options))


def random_rays(vertices: np.ndarray, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Float32 rays from points in and around the bounding box to others near it, of any length."""
    rng = np.random.default_rng(seed)
    low, high = vertices.min(0).astype(float), vertices.max(0).astype(float)
    middle, size = (low + high) / 2, np.linalg.norm(high - low)
    origin = (middle + size * rng.uniform(-1, 1, (count, 3))).astype(np.float32)
    target = middle + size * rng.uniform(-0.4, 0.4, (count, 3))
    return origin, ((target - origin) * rng.uniform(0.5, 2.0, (count, 1))).astype(np.float32)


class Crossing:
    """Where rays cross the planes of given faces, in float64, with the errors that float32 coordinates allow.

    `t` in lengths of the direction, `t_error` what rounding of the coordinates may change it by, `inside` the distance
    (in units of that rounding) from the crossing to the nearest side of the face, negative outside.
    """

    def __init__(self, vertices, faces, origin, direction):
        corners = vertices.astype(float)[faces]
        o, d = origin.astype(float), direction.astype(float)
        a, b, c = (corners[..., k, :] for k in range(3))
        normal = np.cross(b - a, c - a)
        slope = (d * normal).sum(-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.t = ((a - o) * normal).sum(-1) / slope
            point = o + self.t[..., None] * d
            incidence = np.abs(slope) / np.linalg.norm(d, axis=-1) / np.linalg.norm(normal, axis=-1)
            largest = np.maximum(np.abs(corners).max((-1, -2)), np.abs(o).max(-1))
            rounding = 16 * EPS * largest / incidence
            self.t_error = rounding / np.linalg.norm(d, axis=-1)
            unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
            inside = []
            for p, q in ((a, b), (b, c), (c, a)):
                inward = np.cross(unit, q - p) / np.linalg.norm(q - p, axis=-1, keepdims=True)
                inside.append(((point - p) * inward).sum(-1))
            self.inside = np.min(inside, axis=0) / rounding


def every_crossing(vertices, faces, origin, direction) -> Crossing:
    """Every ray with every face [N, F]."""
    n, f = len(origin), len(faces)
    rays = (np.broadcast_to(x[:, None], (n, f, 3)) for x in (origin, direction))
    return Crossing(vertices, np.broadcast_to(faces[None], (n, f, 3)), *rays)
