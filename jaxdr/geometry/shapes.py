"""Procedural meshes: z is up, closed shapes have outward normals, shading is flat (`Mesh.smooth()` changes that)."""

from collections.abc import Sequence
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked, shown
from jaxdr.arrays import numpy_for, traced
from jaxdr.geometry.mesh import Mesh, MeshArrays, weld
from jaxdr.geometry.vector import transform

Vector = ArrayLike | Sequence  # beartype does not count a tuple as ArrayLike
ORIGIN = (0.0, 0.0, 0.0)
MOST_FACES = 1 << 29  # what the finest geodesic sphere has is less


@checked
def sphere(
    subdivisions: int = 3, radius: float = 1.0, center: Vector = ORIGIN, *, vertex_count: int | None = None
) -> Mesh:
    """Geodesic sphere: an icosahedron whose edges are split into n parts, projected outwards.

    n is 2^subdivisions. If `vertex_count` is given, n is chosen so that the number of vertices, 10 n² + 2, is close to
    it. Raises ValueError for negative subdivisions, fewer than 12 vertices or a radius that is not positive.
    """
    _require(radius > 0, "sphere: radius must be positive", radius)
    points, faces = _geodesic("sphere", subdivisions, vertex_count)
    return Mesh(radius * points + _vector("sphere: center", center), faces)


@checked
def displaced_sphere(
    subdivisions: int = 4,
    amplitude: float = 0.15,
    frequency: float = 6.0,
    radius: float = 1.0,
    center: Vector = ORIGIN,
    *,
    vertex_count: int | None = None,
) -> Mesh:
    """Bumpy sphere with many concave edges: the distance from the center varies by ± `amplitude` · `radius`.

    The bumps are the gyroid sin x cos y + sin y cos z + sin z cos x, with (x, y, z) = `frequency` times a point of the
    unit sphere. Raises ValueError like `sphere`, and for an amplitude outside [0, 1).
    """
    _require(radius > 0, "displaced_sphere: radius must be positive", radius)
    _require(0 <= amplitude < 1, "displaced_sphere: amplitude must be in [0, 1)", amplitude)
    points, faces = _geodesic("displaced_sphere", subdivisions, vertex_count)
    x, y, z = frequency * points.T
    gyroid = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)  # in [-1.5, 1.5]
    distance = radius * (1 + amplitude * gyroid / 1.5)
    return Mesh(distance[:, None] * points + _vector("displaced_sphere: center", center), faces)


@checked
def box(size: Vector = 1.0, center: Vector = ORIGIN) -> Mesh:
    """Axis-aligned box; `size` is the edge length, or three of them. UVs cover [0, 1]² on every side.

    Raises `ValueError` for a size that is not positive.
    """
    size = np.asarray(size, float)
    _require(size.shape in ((), (3,)) and np.all(size > 0), "box: size must be one or three positive lengths", size)
    # Corner number 4 x + 2 y + z; each quad counter-clockwise from outside.
    points = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    uvs = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    uv_faces = _triangulated(np.tile(np.arange(4), (6, 1)))
    return Mesh(size * points + _vector("box: center", center), _triangulated(quads), uvs, uv_faces)


@checked
def rectangle(width: float = 1.0, height: float = 1.0, center: Vector = ORIGIN) -> Mesh:
    """Two triangles in the plane z = 0, facing +z, with `width` along x and `height` along y; UVs in [0, 1]².

    Raises `ValueError` for a width or height that is not positive.
    """
    _require(width > 0 and height > 0, "rectangle: width and height must be positive", (width, height))
    return _grid(width, height, 1, _vector("rectangle: center", center))


@checked
def plane(size: float = 10.0, resolution: int = 1, center: Vector = ORIGIN) -> Mesh:
    """Square of edge length `size` in the plane z = 0, facing +z, of `resolution`² quads; UVs in [0, 1]².

    Raises `ValueError` for a size that is not positive or a resolution below 1.
    """
    _require(size > 0, "plane: size must be positive", size)
    _require(resolution >= 1, "plane: resolution must be at least 1", resolution)
    _check_size("plane: resolution", 2 * resolution**2)
    return _grid(size, size, resolution, _vector("plane: center", center))


@checked
def torus(
    major_radius: float = 1.0, minor_radius: float = 0.4, major_segments: int = 64, minor_segments: int = 32
) -> Mesh:
    """Torus around the z axis: a tube of `minor_radius` around a circle of `major_radius`.

    Raises `ValueError` unless 0 < minor_radius < major_radius and both segment counts are at least 3.
    """
    _require(
        0 < minor_radius < major_radius, "torus: need 0 < minor_radius < major_radius", (minor_radius, major_radius)
    )
    _check_size("torus: major_segments or minor_segments", 2 * abs(major_segments * minor_segments))
    around, across = _circle("torus: major_segments", major_segments), _circle("torus: minor_segments", minor_segments)
    distance = major_radius + minor_radius * across[:, 0]
    height = np.broadcast_to(minor_radius * across[:, 1], (major_segments, minor_segments))
    points = np.stack([np.outer(around[:, 0], distance), np.outer(around[:, 1], distance), height], axis=-1)
    return Mesh(points.reshape(-1, 3), _periodic_faces(major_segments, minor_segments))


@checked
def trefoil_tube(radius: float = 0.12, segments: int = 256, sides: int = 24) -> Mesh:
    """Tube along a trefoil knot: a shape that shadows itself. Its centre line stays within 1 of the origin.

    The centre line is (sin t + 2 sin 2t, cos t - 2 cos 2t, -sin 3t) / 3. Raises ValueError for fewer than 3 segments or
    sides, and for a radius outside (0, 0.2): with larger radii the strands would intersect.
    """
    _require(0 < radius < 0.2, "trefoil_tube: radius must be in (0, 0.2)", radius)
    _require(segments >= 3, "trefoil_tube: segments must be at least 3", segments)
    _check_size("trefoil_tube: segments or sides", 2 * abs(segments * sides))
    t = 2 * np.pi * np.arange(segments) / segments
    line = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1) / 3
    velocity = np.stack([np.cos(t) + 4 * np.cos(2 * t), -np.sin(t) + 4 * np.sin(2 * t), -3 * np.cos(3 * t)], axis=1)
    acceleration = np.stack([-np.sin(t) - 8 * np.sin(2 * t), -np.cos(t) + 8 * np.cos(2 * t), 9 * np.sin(3 * t)], axis=1)
    # Frenet frame: the curvature is nowhere zero, so the frame closes without a twist.
    binormal = _unit(np.cross(velocity, acceleration))
    normal = np.cross(binormal, _unit(velocity))  # tangent = normal × binormal
    across = _circle("trefoil_tube: sides", sides)
    ring = across[:, :1] * normal[:, None] - across[:, 1:] * binormal[:, None]
    return Mesh((line[:, None] + radius * ring).reshape(-1, 3), _periodic_faces(segments, sides))


@checked
def revolved(profile: Vector, segments: int = 64) -> Mesh:
    """Solid of revolution around the z axis from a profile of (distance from the axis, height) rows [n, 2].

    The profile may run up or down. An end that is off the axis is closed by a flat cap.

    Raises ValueError for a profile with fewer than two rows, with numbers that are not finite, with a distance that is
    negative or (except at the ends) zero, and for one that encloses no area with the axis. Raises ValueError for fewer
    than three segments.
    """
    profile = np.asarray(profile, float)
    _require(profile.ndim == 2 and profile.shape[1] == 2, "revolved: profile must have shape [n, 2]", profile.shape)
    _require(len(profile) >= 2, "revolved: profile needs at least two rows", len(profile))
    _require(np.isfinite(profile).all(), "revolved: profile must be finite", profile.tolist())
    distance, height = profile.T
    _require(
        np.all(distance >= 0) and np.all(distance[1:-1] > 0),
        "revolved: distances from the axis must be positive, or zero at the ends",
        distance.tolist(),
    )
    bottom, top = height[[0, -1]]
    rings = profile[distance > 0]
    outline = np.vstack([[0, bottom], rings, [0, top]])
    double_area = np.sum(outline[:-1, 0] * outline[1:, 1] - outline[1:, 0] * outline[:-1, 1])
    _require(double_area != 0, "revolved: profile encloses no area with the axis", profile.tolist())
    if double_area < 0:  # the profile runs down
        rings, bottom, top = rings[::-1], top, bottom

    _check_size("revolved: segments", 2 * abs(segments) * len(profile))
    around = _circle("revolved: segments", segments)
    points = np.empty((len(rings), segments, 3))
    points[..., :2] = rings[:, None, :1] * around
    points[..., 2] = rings[:, None, 1]
    poles = [[0, 0, bottom], [0, 0, top]]

    index = np.arange(len(rings) * segments).reshape(-1, segments)
    following = np.roll(index, -1, axis=1)
    sides = np.stack([index[:-1], following[:-1], following[1:], index[1:]], axis=-1).reshape(-1, 4)
    south, north = np.full(segments, index.size), np.full(segments, index.size + 1)
    caps = [np.stack([south, following[0], index[0]], 1), np.stack([north, index[-1], following[-1]], 1)]
    return Mesh(np.vstack([points.reshape(-1, 3), poles]), np.vstack([_triangulated(sides), *caps]))


@checked
def pawn(segments: int = 64) -> Mesh:
    """Chess pawn of height 1 on z = 0: foot, waist, collar and head, from a `revolved` profile."""
    _require(segments >= 3, "pawn: segments must be at least 3", segments)
    _check_size("pawn: segments", 100 * segments)
    foot = [(0.28, 0.0), (0.30, 0.03), (0.30, 0.09), (0.27, 0.13), (0.24, 0.15), (0.24, 0.18), (0.20, 0.22)]
    height = np.linspace(0.26, 0.60, 12)
    waist = np.stack([0.10 + 0.075 * ((0.60 - height) / 0.34) ** 2, height], axis=1)
    collar = [(0.17, 0.63), (0.18, 0.65), (0.17, 0.67), (0.11, 0.69)]
    angle = np.linspace(-0.85, np.pi / 2, 18)[:-1]
    head = np.stack([0.16 * np.cos(angle), 0.84 + 0.16 * np.sin(angle)], axis=1)
    return revolved(np.vstack([foot, waist, collar, head, [[0.0, 1.0]]]), segments)


@checked
def duck(subdivisions: int = 4, *, vertex_count: int | None = None) -> Mesh:
    """Bath duck that swims towards +x: a geodesic sphere stretched to a body with head, beak and tail, about 2 long.

    Every ray from the origin meets it once. Raises ValueError like `sphere`.
    """
    points, faces = _geodesic("duck", subdivisions, vertex_count)
    distance = 1.0 / np.linalg.norm(points / (1.0, 0.75, 0.6), axis=1)
    # Bumps: direction, height, sharpness (the inverse of the variance of the angle).
    for direction, height, sharpness in (
        ((0.7, 0.0, 0.9), 0.6, 14.0),
        ((1.0, 0.0, 0.72), 0.28, 80.0),
        ((-0.9, 0.0, 0.45), 0.35, 30.0),
    ):
        cosine = points @ (np.asarray(direction) / np.linalg.norm(direction))
        distance = distance + height * np.exp(sharpness * (cosine - 1.0))
    return Mesh(distance[:, None] * points, faces)


@checked
def star(points: int = 5, outer_radius: float = 1.0, inner_radius: float = 0.4) -> Mesh:
    """Flat star in the plane z = 0, facing +z, with one tip towards +y. As an emitter its shadows have corners.

    Raises `ValueError` for fewer than two points or unless 0 < inner_radius <= outer_radius.
    """
    _require(points >= 2, "star: points must be at least 2", points)
    _check_size("star: points", 2 * points)
    radii = (inner_radius, outer_radius)
    _require(0 < inner_radius <= outer_radius, "star: need 0 < inner_radius <= outer_radius", radii)
    angle = np.pi / 2 + np.pi * np.arange(2 * points) / points
    radius = np.where(np.arange(2 * points) % 2 == 0, outer_radius, inner_radius)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=1)
    index = 1 + np.arange(2 * points)
    return Mesh(np.vstack([[ORIGIN], rim]), np.stack([np.zeros_like(index), index, np.roll(index, -1)], axis=1))


@checked
def transformed(mesh: Mesh, matrix: Vector) -> Mesh:
    """The mesh under an affine map [4, 4] of column vectors. A map that mirrors also reverses the faces.

    So their outside stays outside. Traceable and differentiable. Concrete values are checked: raises ValueError for a
    matrix of another shape, one that is not affine, and one without an inverse.
    """
    if traced(mesh, matrix):
        return _transformed_traced(mesh, matrix)
    uvs = None if mesh.uvs is None else np.asarray(mesh.uvs)
    indices = (None if faces is None else np.asarray(faces) for faces in (mesh.uv_faces, mesh.normal_faces))
    arrays = MeshArrays(np.asarray(mesh.vertices, float), np.asarray(mesh.faces), uvs, *indices)
    return Mesh(*transformed_arrays(arrays, matrix))


def transformed_arrays(arrays: MeshArrays, matrix: Vector) -> MeshArrays:
    """`transformed` for the arrays of a mesh."""
    matrix = np.asarray(matrix, float)
    mirrors = _mirrors(matrix)
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    moved = arrays._replace(vertices=arrays.vertices @ linear.T + offset)
    return moved.turned() if mirrors else moved


def _transformed_traced(mesh: Mesh, matrix: Vector) -> Mesh:
    """`transformed` if the mesh or the matrix is traced. The edges stay in their order."""
    known = None if traced(matrix) else _mirrors(np.asarray(matrix, float))
    matrix = jnp.asarray(matrix, mesh.vertices.dtype)
    _require(matrix.shape == (4, 4), "transformed: matrix must have shape [4, 4]", matrix.shape)
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    moved = mesh.with_vertices(transform(linear, mesh.vertices) + offset)
    if known is None:
        return moved.turned(jnp.linalg.det(jax.lax.stop_gradient(linear)) < 0)
    return moved.turned(known)


def _mirrors(matrix: Float[np.ndarray, "..."]) -> bool:
    """Whether an affine map mirrors. Raises ValueError for other matrices, and for those without an inverse."""
    _require(matrix.shape == (4, 4), "transformed: matrix must have shape [4, 4]", matrix.shape)
    _require(np.array_equal(matrix[3], [0, 0, 0, 1]), "transformed: the last row must be 0 0 0 1", matrix[3].tolist())
    determinant = np.linalg.det(matrix[:3, :3])
    _require(np.isfinite(determinant) and determinant != 0, "transformed: matrix has no inverse", matrix.tolist())
    return bool(determinant < 0)


@checked
def centred(mesh: Mesh, size: float) -> Mesh:
    """The mesh with its bounding box around the origin, the longest side `size` long.

    Traceable, like `transformed`. Raises ValueError for a size that is not positive.
    """
    if not traced(size):
        _require(size > 0, "centred: size must be positive", size)
    xp = numpy_for(mesh.vertices, size)
    points = xp.asarray(mesh.vertices, float)
    low, high = points.min(0), points.max(0)
    factor = size / (high - low).max()
    top = xp.concatenate([factor * xp.eye(3), (-factor * (low + high) / 2)[:, None]], axis=1)
    return transformed(mesh, xp.concatenate([top, xp.asarray([[0.0, 0.0, 0.0, 1.0]])]))


def _require(condition: bool | np.bool_, message: str, value) -> None:
    if not condition:
        raise ValueError(f"{message}, got {shown(value)}")


def _vector(name: str, value: Vector) -> Float[np.ndarray, "3"]:
    array = np.asarray(value, float)
    _require(array.shape == (3,) and np.isfinite(array).all(), f"{name} must be three finite numbers", value)
    return array


def _check_size(name: str, faces: int) -> None:
    """Raises ValueError for a mesh of more faces than there is a use for, before memory is asked for."""
    _require(faces <= MOST_FACES, f"{name} asks for more than {MOST_FACES} faces", faces)


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _circle(name: str, segments: int) -> Float[np.ndarray, "segments 2"]:
    _require(segments >= 3, f"{name} must be at least 3", segments)
    angle = 2 * np.pi * np.arange(segments) / segments
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _triangulated(quads: Int[np.ndarray, "n 4"]) -> Int[np.ndarray, "m 3"]:
    return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _periodic_faces(rows: int, columns: int) -> Int[np.ndarray, "m 3"]:
    """Triangles of a rows × columns grid of vertices that wraps around both ways."""
    index = np.arange(rows * columns).reshape(rows, columns)
    next_row = np.roll(index, -1, axis=0)
    quads = [index, next_row, np.roll(next_row, -1, axis=1), np.roll(index, -1, axis=1)]
    return _triangulated(np.stack(quads, axis=-1).reshape(-1, 4))


def _grid(width: float, height: float, resolution: int, center: Float[np.ndarray, "3"]) -> Mesh:
    u, v = np.meshgrid(*2 * [np.linspace(0, 1, resolution + 1)])
    uvs = np.stack([u.ravel(), v.ravel()], axis=1)
    points = np.column_stack([(uvs - 0.5) * (width, height), np.zeros(len(uvs))])
    index = np.arange(len(uvs)).reshape(resolution + 1, resolution + 1)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1)
    faces = _triangulated(quads.reshape(-1, 4))
    return Mesh(points + center, faces, uvs, faces)


FINEST = 12  # subdivisions: 168 million vertices


def _geodesic(
    name: str, subdivisions: int, vertex_count: int | None
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Unit sphere from an icosahedron whose faces are split into n² triangles."""
    _require(subdivisions >= 0, f"{name}: subdivisions must not be negative", subdivisions)
    _require(subdivisions <= FINEST, f"{name}: subdivisions must not exceed {FINEST}", subdivisions)
    _require(vertex_count is None or vertex_count >= 12, f"{name}: vertex_count must be at least 12", vertex_count)
    _check_size(f"{name}: vertex_count", 2 * (vertex_count or 0))
    n = 2**subdivisions if vertex_count is None else max(1, round(np.sqrt((vertex_count - 2) / 10)))

    golden = (1 + np.sqrt(5)) / 2
    corners = np.array([np.roll([0, y, z], k) for y in (-1, 1) for z in (-golden, golden) for k in range(3)])
    adjacent = np.isclose(np.linalg.norm(corners[:, None] - corners, axis=-1), 2)
    triples = np.array([(a, b, c) for a, b, c in combinations(range(12), 3) if adjacent[[a, b, c], [b, c, a]].all()])

    # Triangular lattice of one face (padded with -1), and its small triangles.
    i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
    lattice = np.full((n + 2, n + 2), -1)
    lattice[i, j] = np.arange(len(i))
    right, above, diagonal = lattice[i + 1, j], lattice[i, j + 1], lattice[i + 1, j + 1]
    small = np.stack([np.stack([lattice[i, j], right, above], 1), np.stack([right, diagonal, above], 1)])
    small = small[(small >= 0).all(axis=-1)]

    a, b, c = (corners[triples[:, k], None] for k in range(3))
    # Triples are ascending, so both faces at an edge sum in the same order. So their points are equal, for `weld`.
    points = (n - i - j)[:, None] * a + i[:, None] * b + j[:, None] * c
    outward = np.linalg.det(corners[triples]) > 0
    faces = np.where(outward[:, None, None], small, small[:, ::-1]) + len(i) * np.arange(20)[:, None, None]
    points, faces = weld(points.reshape(-1, 3), faces.reshape(-1, 3))
    return _unit(points), faces
