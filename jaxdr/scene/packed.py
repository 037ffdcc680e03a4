"""A scene as flat tables over all shapes, ready for tracing: one vertex array, one face array, one row for each shape.

Packing happens inside the traced function, so every table is a differentiable function of the scene's parameters.
There are tables only for what the scene has: one group for each kind of BSDF, emitter tables with emitters, shading
normals with smooth shapes, texture coordinates with textures that use them.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.edges import INTERIOR, edge_shares
from jaxdr.geometry.gather import rows_of
from jaxdr.geometry.queries.records import Geometry
from jaxdr.geometry.vector import corners, cross, dot, interpolate, norm, normalize, transform
from jaxdr.scene.bsdf import BSDF, TwoSided
from jaxdr.scene.bsdf.base import has_lobe, spreads_through
from jaxdr.scene.camera import Camera
from jaxdr.scene.color import magnitude
from jaxdr.scene.emitter_clusters import FEW_FACES, EmitterClusters, emitter_clusters
from jaxdr.scene.emitters import DirectionSampler, Environment
from jaxdr.scene.packed_lights import LightGroup, emitter_choice, group_lights
from jaxdr.scene.sampling import probabilities
from jaxdr.scene.scene import Scene, textures_of, unwrap
from jaxdr.scene.textures import Texture, TexturePoint, textures_in

# Textures of emitters are looked up at this number of points on all emitting faces together, about. The points of one
# face are the square of a number between the two others.
MEAN_POINTS, LEAST_SIDE, MOST_SIDE = 1 << 14, 2, 32


class PackedEdges(eqx.Module):
    """Edges of all shapes. Indices refer to the packed vertices and faces; -1 is padding.

    `share`: which share of a jump counts at each edge, see `edge_shares`; None where all of it does at every edge.
    """

    vertices: Int[Array, "E 2"]
    faces: Int[Array, "E K"]
    opposite: Int[Array, "E K"]
    interior: Bool[Array, " E"]
    shape: Int[Array, " E"]
    share: Float[Array, " E"] | None = None

    def shared(self, edge: Int[Array, " n"], value: Float[Array, " n"]) -> Float[Array, " n"]:
        """Values at edges times the share that counts there."""
        return value if self.share is None else value * self.share[edge]


class BSDFGroup(eqx.Module):
    """All BSDFs of one kind, with their fields stacked.

    BSDFs of one kind have the same static fields, and textures of the same kinds and sizes. `member`: which shapes have
    a BSDF of this kind. `row`: the row of every shape, 0 for shapes with another kind.
    """

    bsdf: BSDF
    row: Int[Array, " S"]
    member: Bool[Array, " S"]

    def at(self, shape: Int[Array, " N"], point: TexturePoint | None) -> BSDF:
        """The BSDFs of shapes at points on them, with textures looked up. Only members get their own BSDF."""
        row = self.row[shape]

        def at_points(field):
            return field.values(row, point) if point is not None and isinstance(field, Texture) else rows_of(field, row)

        return jax.tree.map(at_points, self.bsdf, is_leaf=lambda field: isinstance(field, Texture))


class GlowGroup(eqx.Module):
    """Radiance textures of one kind and size, with their fields stacked; `row` and `member` are as in `BSDFGroup`."""

    texture: Texture
    row: Int[Array, " S"]
    member: Bool[Array, " S"]


class Triangles(NamedTuple):
    """N faces: vertices, unit normals (zero for a face without area), areas, and largest absolute coordinates."""

    a: Float[Array, "N 3"]
    b: Float[Array, "N 3"]
    c: Float[Array, "N 3"]
    normal: Float[Array, "N 3"]
    area: Float[Array, " N"]
    largest: Float[Array, " N"]


class PackedScene(eqx.Module):
    """Tables over all shapes of a scene: S shapes, V vertices, F faces, L emitting faces.

    - `first_face[i]` to `first_face[i + 1]` are the faces of shape i. Its vertices start at `first_vertex[i]`, and it
      has `edge_counts[i]` edges.
    - `table`: all `Triangles`; `size`: the diagonal of the scene's bounding box.
    - `centre`: the world position of the origin, see `centre_of`. All positions here are relative to it.
    - `uv_faces`: 0 on all faces of shapes that use no UVs.
    - `radiance`: that of emitters without a texture; `glow`: that of emitters with one.
    - `emitter_cdf`, `emitter_density` (per area, zero on other faces): how emitting faces are chosen by their power.
    - `clusters`: which emitting faces matter at a point; None unless there are more than `FEW_FACES` of them.
    - `choice`: cumulative probabilities of the emitters, see `emitter_choice`; None unless there are several.
    - `environment_turns`: directions to the environment turn with it. Otherwise they are fixed in the world, and the
      radiance seen in them changes.
    """

    vertices: Float[Array, "V 3"]
    faces: Int[Array, "F 3"]
    table: Float[Array, "F 14"]
    size: Float[Array, ""]
    centre: Float[Array, "3"]
    face_shape: Int[Array, " F"]
    edges: PackedEdges
    bsdfs: tuple[BSDFGroup, ...]
    two_sided: Bool[Array, " S"]
    first_vertex: tuple[int, ...] = eqx.field(static=True)
    first_face: tuple[int, ...] = eqx.field(static=True)
    edge_counts: tuple[int, ...] = eqx.field(static=True)
    closed: tuple[bool, ...] = eqx.field(static=True)
    smooth: tuple[bool, ...] = eqx.field(static=True)
    normals: Float[Array, "G 3"] | None
    normal_faces: Int[Array, "F 3"] | None
    uvs: Float[Array, "T 2"] | None
    uv_faces: Int[Array, "F 3"] | None
    radiance: Float[Array, "S 3"] | None
    emitter_faces: Int[Array, " L"] | None
    emitter_cdf: Float[Array, " L"] | None
    emitter_density: Float[Array, " F"] | None
    clusters: EmitterClusters | None
    glow: tuple[GlowGroup, ...]
    camera: Camera
    environment: Environment | None
    environment_sampler: DirectionSampler | None
    lights: tuple[LightGroup, ...]
    choice: Float[Array, " K"] | None
    environment_turns: bool = eqx.field(static=True, default=False)

    @property
    def geometry(self) -> Geometry:
        """The triangles, as ray queries take them."""
        return Geometry(self.vertices, self.faces)

    @property
    def textured(self) -> bool:
        """Whether any BSDF or emitter has textures."""
        return bool(textures_in((self.bsdfs, self.glow)))

    @property
    def uses_faces(self) -> bool:
        """Whether any BSDF has one value for every face."""
        return any(texture.uses_faces for _, texture in textures_in(self.bsdfs))

    @property
    def has_seams(self) -> bool:
        """Whether textures of BSDFs may be discontinuous at edges inside a mesh."""
        return self.uvs is not None or self.uses_faces

    @property
    def uses_slopes(self) -> bool:
        """Whether any texture needs the lengths on the surface that u and v stand for."""
        return any(texture.uses_slopes for _, texture in textures_in(self.bsdfs))

    @property
    def tangential(self) -> bool:
        """Whether any BSDF needs the direction in which u increases."""
        return any(group.bsdf.tangential for group in self.bsdfs)

    @property
    def has_area_emitters(self) -> bool:
        """Whether any shape glows."""
        return self.emitter_faces is not None

    @property
    def has_varying_sky(self) -> bool:
        """Whether the radiance of the environment depends on the direction."""
        return self.environment is not None and not self.environment.uniform

    @property
    def has_delta_lobes(self) -> bool:
        """Whether any BSDF scatters light of one direction into single directions (delta lobes)."""
        return any(group.bsdf.delta for group in self.bsdfs)

    @property
    def spreads_through(self) -> Bool[Array, " S"] | None:
        """Which shapes scatter light through their surface into a range of directions; None if no shape does."""
        return self._shapes_with(spreads_through)

    @property
    def glossy(self) -> Bool[Array, " S"] | None:
        """Which shapes have a lobe that may be narrow; None if no shape has."""
        return self._shapes_with(has_lobe)

    def _shapes_with(self, holds: Callable[[BSDF], bool]) -> Bool[Array, " S"] | None:
        """Which shapes have a BSDF of which this holds; None if no shape has."""
        members = [group.member for group in self.bsdfs if holds(group.bsdf)]
        return jnp.stack(members).any(0) if members else None

    def edges_of(self, shapes: tuple[bool, ...]) -> Int[Array, " E"]:
        """Indices of the edges of the chosen shapes."""
        return _rows_of(np.cumsum([0, *self.edge_counts]), shapes)

    def faces_of(self, shapes: tuple[bool, ...]) -> tuple[Int[Array, " F"], Callable[[Array], Array]]:
        """(indices of the faces of the chosen shapes, function from such indices to their rows in this list)."""
        first, counts = np.asarray(self.first_face[:-1]), np.diff(self.first_face) * np.asarray(shapes)
        shift = jnp.asarray(first - np.cumsum([0, *counts])[:-1], jnp.int32)
        return _rows_of(self.first_face, shapes), lambda face: face - shift[self.face_shape[face]]

    def shape_bounds(self) -> tuple[Float[Array, "S 3"], Float[Array, "S 3"]]:
        """Lowest and highest coordinates of every shape (scene units), detached."""
        points = stop_gradient(self.vertices)[self.faces]
        parts = [points[a:b] for a, b in itertools.pairwise(self.first_face)]
        return jnp.stack([p.min((0, 1)) for p in parts]), jnp.stack([p.max((0, 1)) for p in parts])

    def shape_sizes(self) -> Float[Array, " S"]:
        """Bounding-box diagonal of every shape (scene units), detached."""
        lower, upper = self.shape_bounds()
        return norm(upper - lower)

    def triangles(self, face: Int[Array, " N"]) -> Triangles:
        """Rows of the table of faces. One look-up brings everything that a point on a face depends on."""
        a, b, c, normal, *rest = jax.lax.split(rows_of(self.table, face), (3, 3, 3, 3, 1, 1), 1)
        return Triangles(a, b, c, normal, *(jax.lax.squeeze(x, (1,)) for x in rest))

    def corners_of(self, face: Int[Array, "*n"]) -> Float[Array, "*n 3 3"]:
        """The corners of faces (scene units)."""
        return rows_of(self.vertices, self.faces[face])

    def ends_of(self, edge: Int[Array, "*n"]) -> Float[Array, "*n 2 3"]:
        """The two ends of edges (scene units)."""
        return rows_of(self.vertices, self.edges.vertices[edge])

    def with_vertices(self, vertices: Float[Array, "V 3"]) -> "PackedScene":
        """The same scene with other vertices and all that depends on them, but with the old choice of emitters."""
        table, size = _face_table(vertices, self.faces), _size(vertices)
        return dataclasses.replace(self, vertices=vertices, table=table, size=size)

    def face_normals(self) -> Float[Array, "F 3"]:
        """Unit normals of all faces."""
        return self.table[:, 9:12]

    def turned(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """The same directions to the environment. With `environment_turns` their derivative turns with it."""
        return transform(self.environment.turn(), direction) if self.environment_turns else direction

    @property
    def light_count(self) -> int:
        """Number of lights without area."""
        return self.lights[0].row.shape[0] if self.lights else 0

    def place_of(self, group: LightGroup, number: Int[Array, " N"]) -> Float[Array, "*#n 3"]:
        """Positions of the lights of a group by number; unit directions towards them if they are infinitely far."""
        place = group.at(number).place()
        return place if group.light.infinite else place - self.centre

    def borders_of(self, group: LightGroup) -> Float[Array, "K 3 3"] | None:
        """Where the light of a group ends abruptly, see `DeltaLight.borders`; None if it has no such lines.

        The points are relative to the origin, not to the light.
        """
        borders = None if group.stacked else group.light.borders()
        return None if borders is None else borders + (group.light.place() - self.centre)

    def texture_point(self, face: Int[Array, " N"], on_face: Float[Array, "N 3"]) -> TexturePoint:
        """The points, by face and barycentric coordinates, as textures are looked up at them."""
        uv = None
        if self.uvs is not None:
            uv = interpolate(rows_of(self.uvs, self.uv_faces[face]), on_face)
        shape, of_mesh = self.face_shape[face], None
        first = jnp.asarray(self.first_vertex, jnp.int32)[shape]
        if any(texture.uses_faces for _, texture in textures_in((self.bsdfs, self.glow))):
            of_mesh = face - jnp.asarray(self.first_face, jnp.int32)[shape]
        return TexturePoint(uv, on_face, self.faces[face] - first[:, None], of_mesh)

    def surface_radiance(self, face: Int[Array, " N"], on_face: Float[Array, "N 3"] | None) -> Float[Array, "N 3"]:
        """Radiance emitted at points of faces, zero where nothing glows. Only textures need barycentric coordinates."""
        shape = self.face_shape[face]
        if self.radiance is None:
            radiance = jnp.zeros((*face.shape, 3), self.vertices.dtype)
        else:
            radiance = rows_of(self.radiance, shape)
        if self.glow:
            assert on_face is not None  # there wherever the scene has textures
            at = self.texture_point(face, on_face)
            for group in self.glow:
                radiance = jnp.where(group.member[shape][:, None], group.texture.values(group.row[shape], at), radiance)
        return radiance


def _face_table(vertices, faces) -> Float[Array, "F 14"]:
    """All `Triangles`, as one table."""
    a, b, c = triangle = corners(vertices[faces])
    normal2 = cross(b - a, c - a)
    largest = jnp.abs(stop_gradient(jnp.stack(triangle))).max((0, 2))
    parts = (*triangle, normalize(normal2), 0.5 * norm(normal2)[:, None], largest[:, None])
    return jnp.concatenate(parts, -1)


def _size(vertices) -> Float[Array, ""]:
    """Bounding-box diagonal (scene units), detached."""
    points = stop_gradient(vertices)
    return norm(points.max(0) - points.min(0))


def centre_of(vertices: Float[Array, "V 3"]) -> Float[Array, "3"]:
    """The point of a coarse grid that is next to the middle of a scene: where packing puts its origin; detached.

    Rounding grows with coordinates, and distances that stand for it, such as `queries.BESIDE`, grow as well. So a scene
    of a city's coordinates is traced at the origin. The grid has two to four times the scene's size. So nearby scenes
    keep their coordinates, and the difference of a coordinate and the centre is exact.
    """
    points = stop_gradient(vertices)
    lower, upper = points.min(0), points.max(0)
    _, exponent = jnp.frexp(norm(upper - lower))
    spacing = jnp.ldexp(jnp.ones_like(points[0, 0]), exponent + 1)
    return spacing * jnp.round(0.5 * (lower + upper) / spacing)


def _seen_from(pose: Float[Array, "4 4"], centre: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """A pose in the world as a pose relative to a centre."""
    shift = jnp.pad(centre[:, None], ((0, 1), (3, 0)))
    return pose - shift.astype(pose.dtype)


def _emitter_tables(packed: PackedScene):
    """(cumulative probabilities of emitting faces, density per area on every face, total power, clusters); detached.

    Faces are chosen in proportion to power, and a part of the choice is by area: an emitter that is off now, or a black
    texel, has a derivative too. With textures the mean radiance of a face is estimated at a few points.
    """
    packed = stop_gradient(packed)
    faces = packed.emitter_faces
    assert faces is not None  # asked only where something glows
    area = packed.triangles(faces).area
    if packed.glow:
        power = area * _mean_magnitude(packed)
    else:
        power = area * magnitude(packed.radiance[packed.face_shape[faces]])
    weight, count = probabilities(power, area), packed.faces.shape[0]
    cumulative = jnp.cumsum(weight)
    cdf = cumulative / cumulative[-1]
    density = jnp.diff(cdf, prepend=0.0) / jnp.where(area > 0, area, 1.0)
    clusters = None
    if faces.shape[0] > FEW_FACES:
        clusters = emitter_clusters(packed.corners_of(faces), faces, weight, count)
    return cdf, jnp.zeros(count, cdf.dtype).at[faces].set(density), power.sum(), clusters


def _rows_of(first, shapes: tuple[bool, ...]) -> Int[Array, " n"]:
    """Rows first[i] to first[i + 1] of every chosen shape i."""
    chosen = [np.arange(first[i], first[i + 1]) for i, used in enumerate(shapes) if used]
    return jnp.asarray(np.concatenate(chosen), jnp.int32)


def pack(scene: Scene) -> PackedScene:
    """Flat tables of a scene. All its float parameters may be traced."""
    shapes = list(scene.shapes.values())
    meshes = [shape.mesh for shape in shapes]
    first_vertex = np.cumsum([0, *(m.vertices.shape[0] for m in meshes)])
    first_face = np.cumsum([0, *(m.faces.shape[0] for m in meshes)])
    counts = [m.faces.shape[0] for m in meshes]
    bsdfs = [unwrap(shape.bsdf) for shape in shapes]
    normals, normal_faces = _normals(meshes)
    uvs, uv_faces = _uvs(shapes)
    glows = [shape.emitter.radiance if shape.emitter else None for shape in shapes]
    emitting = [i for i, glow in enumerate(glows) if glow is not None]
    radiance = emitter_faces = None
    if emitting:
        radiance = _constant_radiance(glows, meshes[0].vertices.dtype)
        emitter_faces = jnp.asarray(np.concatenate([np.arange(first_face[i], first_face[i + 1]) for i in emitting]))
    vertices = jnp.concatenate([m.vertices for m in meshes])
    centre = centre_of(vertices)
    vertices = vertices - centre
    faces = _numbered([m.faces for m in meshes], first_vertex)
    packed = PackedScene(
        vertices=vertices,
        faces=faces,
        table=_face_table(vertices, faces),
        size=_size(vertices),
        centre=centre,
        face_shape=jnp.asarray(np.repeat(np.arange(len(shapes)), counts), jnp.int32),
        edges=_pack_edges(meshes, first_vertex, first_face),
        bsdfs=group_bsdfs(bsdfs),
        two_sided=jnp.asarray([isinstance(shape.bsdf, TwoSided) for shape in shapes]),
        first_vertex=tuple(int(v) for v in first_vertex[:-1]),
        first_face=tuple(int(f) for f in first_face),
        edge_counts=tuple(m.edges.vertices.shape[0] for m in meshes),
        closed=tuple(m.closed for m in meshes),
        smooth=tuple(m.normal_faces is not None for m in meshes),
        normals=normals,
        normal_faces=normal_faces,
        uvs=uvs,
        uv_faces=uv_faces,
        radiance=radiance,
        emitter_faces=emitter_faces,
        emitter_cdf=None,
        emitter_density=None,
        clusters=None,
        glow=_group_glow(glows),
        camera=eqx.tree_at(lambda camera: camera.to_world, scene.camera, _seen_from(scene.camera.to_world, centre)),
        environment=scene.environment,
        environment_sampler=scene.environment and scene.environment.sampler(),
        lights=group_lights(list(scene.lights.values())),
        choice=None,
    )
    surfaces = None
    if packed.has_area_emitters:
        cdf, density, surfaces, clusters = _emitter_tables(packed)
        packed = dataclasses.replace(packed, emitter_cdf=cdf, emitter_density=density, clusters=clusters)
    if (scene.environment is not None) + packed.has_area_emitters + packed.light_count < 2:
        return packed
    choice = emitter_choice(packed.size, packed.environment_sampler, surfaces, packed.lights)
    return dataclasses.replace(packed, choice=choice)


def _numbered(tables: list[Int[Array, "_ K"]], first) -> Int[Array, "N K"]:
    """Index tables of meshes as one table. The indices of mesh i are shifted by `first[i]`; -1 stays.

    The number of operations does not grow with the number of meshes.
    """
    joined = jnp.concatenate(tables)
    offset = np.repeat(np.asarray(first[: len(tables)]), [table.shape[0] for table in tables])
    return jnp.where(joined >= 0, joined + jnp.asarray(offset[:, None], joined.dtype), -1)


def _normals(meshes):
    """(shading normals of all smooth meshes, corner indices into them, -1 on flat meshes); None if all are flat."""
    if all(m.normal_faces is None for m in meshes):
        return None, None
    normals, indices, first = [], [], 0
    for mesh in meshes:
        if mesh.normal_faces is None:
            indices.append(jnp.full(mesh.faces.shape, -1, jnp.int32))
        else:
            indices.append(mesh.normal_faces + first)
            normals.append(mesh.vertex_normals())
            first += mesh.normal_group_count
    return jnp.concatenate(normals), jnp.concatenate(indices)


def _uvs(shapes):
    """(UVs of the shapes that use them, indices of the corners into them); None if no shape uses any."""
    meshes = [shape.mesh for shape in shapes]
    uses = [unwrap(s.bsdf).tangential or any(texture.uses_uv for _, texture in textures_of(s)) for s in shapes]
    if not any(uses):
        return None, None
    uvs, indices, first = [], [], 0
    for mesh, used in zip(meshes, uses, strict=True):
        if not used:
            indices.append(jnp.zeros(mesh.faces.shape, jnp.int32))
        else:
            indices.append(mesh.uv_faces + first)
            uvs.append(mesh.uvs)
            first += mesh.uvs.shape[0]
    return jnp.concatenate(uvs), jnp.concatenate(indices)


def _pack_edges(meshes, first_vertex, first_face) -> PackedEdges:
    width = max(m.edges.faces.shape[1] for m in meshes)

    def padded(tables):
        missing = [((0, 0), (0, width - table.shape[1])) for table in tables]
        return [jnp.pad(t, m, constant_values=-1) if any(m[1]) else t for t, m in zip(tables, missing, strict=True)]

    counts = [m.edges.vertices.shape[0] for m in meshes]
    doubled = any(m.edges.first is not None for m in meshes)
    return PackedEdges(
        vertices=_numbered([m.edges.vertices for m in meshes], first_vertex),
        faces=_numbered(padded([m.edges.faces for m in meshes]), first_face),
        opposite=_numbered(padded([m.edges.opposite for m in meshes]), first_vertex),
        interior=jnp.concatenate([m.edges.kind for m in meshes]) == INTERIOR,
        shape=jnp.asarray(np.repeat(np.arange(len(meshes)), counts), jnp.int32),
        share=jnp.concatenate([edge_shares(m.edges, m.vertices) for m in meshes]) if doubled else None,
    )


def group_bsdfs(bsdfs: list[BSDF]) -> tuple[BSDFGroup, ...]:
    """The BSDFs of the shapes, grouped by kind."""
    return tuple(BSDFGroup(*group) for group in _stacked(bsdfs))


def _stacked(models: list) -> Iterator[tuple[Any, Int[Array, " S"], Bool[Array, " S"]]]:
    """Groups (stacked fields, row, member) of models of the same static structure and sizes. None is in no group."""
    structures = [m and (jax.tree.structure(m), tuple(map(jnp.shape, jax.tree.leaves(m)))) for m in models]
    for structure in dict.fromkeys(s for s in structures if s is not None):
        members = [i for i, s in enumerate(structures) if s == structure]
        stacked = jax.tree.map(lambda *fields: jnp.stack(fields), *(models[i] for i in members))
        row = np.zeros(len(models), np.int32)
        row[members] = np.arange(len(members))
        member = np.isin(np.arange(len(models)), members)
        yield stacked, jnp.asarray(row), jnp.asarray(member)


def _constant_radiance(glows: list, dtype) -> Float[Array, "S 3"] | None:
    """Radiance of the shapes whose emitters have no texture, black for other shapes; None if there are none."""
    constant = [None if isinstance(glow, Texture) else glow for glow in glows]
    if all(glow is None for glow in constant):
        return None
    black = jnp.zeros(3, dtype)
    return jnp.stack([black if glow is None else glow for glow in constant])


def _group_glow(glows: list) -> tuple[GlowGroup, ...]:
    return tuple(GlowGroup(*g) for g in _stacked([glow if isinstance(glow, Texture) else None for glow in glows]))


def _mean_magnitude(packed: PackedScene) -> Float[Array, " L"]:
    """Mean magnitude of the radiance of emitting faces, from a grid of points on each; detached.

    It only guides the sampling: an error makes noise, not bias.
    """
    packed = jax.tree.map(stop_gradient, packed)
    faces = packed.emitter_faces
    assert faces is not None
    side = int(np.clip((MEAN_POINTS // faces.shape[0]) ** 0.5, LEAST_SIDE, MOST_SIDE))
    points = jnp.asarray(_grid(side), packed.vertices.dtype)

    def magnitude_at(point):
        return magnitude(packed.surface_radiance(faces, jnp.broadcast_to(point, (faces.shape[0], 3))))

    return jax.lax.map(magnitude_at, points, batch_size=max(1, MEAN_POINTS // faces.shape[0])).mean(0)


def _grid(side: int) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of the centres of the side² small triangles that a triangle is cut into."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(side) for j in range(side - i)]
    turned = [(i + 2 / 3, j + 2 / 3) for i in range(side) for j in range(side - i - 1)]
    points = np.array(upright + turned) / side
    return np.concatenate([points, 1.0 - points.sum(1, keepdims=True)], 1)


def concave_edges(packed: PackedScene) -> Bool[Array, " E"]:
    """Interior edges at which the surface folds towards the side that its normals point to, detached.

    Such an edge of a closed opaque surface is never a silhouette, seen from outside.
    """
    vertices, edges = stop_gradient(packed.vertices), packed.edges
    p0, p1 = vertices[edges.vertices[:, 0]], vertices[edges.vertices[:, 1]]
    normal = cross(p1 - p0, vertices[edges.opposite[:, 0]] - p0)
    return edges.interior & (dot(normal, vertices[edges.opposite[:, 1]] - p0) > 0)
