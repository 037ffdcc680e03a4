"""Paths of bidirectional path tracing as functions of their vertices' positions, which boundary estimators move.

Every segment but the camera's has an apex on the camera's side and a target on the emitters' side. A path's vertex is
the target of one segment. Where subpaths are joined, this segment depends on the strategy. So there is a layer of
targets for every segment of a camera subpath, for every emitter sample drawn for its vertices, for every connection,
and for every segment of a subpath from an emitter. The path of a strategy has targets in some of the layers. See
docs/bidirectional_boundary.md.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxdr import loops
from jaxdr.geometry.vector import dot, normalize
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.bidirectional import Drawn, joined_vertices
from jaxdr.transport.connections import Ends, ends, found_emission, with_camera, with_each_other, with_emitters
from jaxdr.transport.emission import EmitterSample, environment_radiance, radiance_towards, surface_radiance
from jaxdr.transport.interaction import SurfacePoint, displaced
from jaxdr.transport.path import Segments
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.subpaths import Subpath


class Layers(NamedTuple):
    """The numbers of layers, for `inner` vertices from emitters; static. The order of the layers is:

    1. segments of camera subpaths, to x_2, x_3, ...;
    2. emitter samples for x_1, x_2, ... from the camera;
    3. connections, in the order of `joined_vertices`;
    4. segments from x_1, x_2, ... back towards emitters.
    """

    inner: int

    @property
    def emitters(self) -> int:
        """First layer of emitter samples."""
        return self.inner

    @property
    def connections(self) -> int:
        """First layer of connections."""
        return 2 * self.inner

    @property
    def light(self) -> int:
        """First layer of subpaths from emitters."""
        return self.connections + len(joined_vertices(self.inner))

    @property
    def count(self) -> int:
        """How many layers there are."""
        return self.light + self.inner

    def used(self) -> Bool[np.ndarray, "L C"]:
        """In which layers each strategy, in the order of `strategies`, has a target."""
        rows = []

        def of_path(camera: int, own: list[int], light: int):
            """Add a strategy with vertices up to 1 + `camera` from the camera, 1 + `light` from emitters (-1: none)."""
            row = np.zeros(self.count, bool)
            row[: max(camera, 0)] = True
            row[own] = True
            row[self.light : self.light + light + 1] = True
            rows.append(row)

        for i in range(self.inner + 1):
            of_path(i, [], -1)
        for i in range(self.inner):
            of_path(i, [self.emitters + i], -1)
        for number, (i, j) in enumerate(joined_vertices(self.inner)):
            of_path(i, [self.connections + number], j)
        for j in range(self.inner):
            of_path(-1, [], j)
        return np.stack(rows, 1)


def layers(drawn: Drawn) -> Layers:
    """The layers of pairs of subpaths."""
    return Layers(drawn.light.density.shape[0])


def target_segments(drawn: Drawn) -> Segments:
    """The segments of all layers, [L, N], detached. Weights are ones, and all segments count as visible."""
    of, camera, light = layers(drawn), drawn.camera, drawn.light
    targets: list[tuple[SurfacePoint, Array, Array]] = []
    apexes: list[SurfacePoint] = []

    def row(tree, number):
        return jax.tree.map(lambda a: a[number], tree)

    for i in range(of.emitters):
        point = row(camera.point, i + 1)
        apexes.append(row(camera.point, i))
        targets.append((point, ~point.valid, -camera.back[i + 1]))
    for i in range(of.inner):
        sample = row(drawn.direct, i)
        apexes.append(row(camera.point, i))
        targets.append((sample.point, sample.infinite, sample.direction))
    on_surface = jnp.zeros_like(drawn.start.infinite), jnp.zeros_like(drawn.start.direction)
    for i, j in joined_vertices(of.inner):
        apexes.append(row(camera.point, i))
        targets.append((row(light.point, j), *on_surface))
    for j in range(of.inner):
        apexes.append(row(light.point, j))
        start = (drawn.start.point, drawn.start.infinite, drawn.start.direction)
        targets.append((row(light.point, j - 1), *on_surface) if j else start)

    face, barycentric, infinite, direction = (
        jnp.stack(parts)
        for parts in zip(*((point.face, point.barycentric, *far) for point, *far in targets), strict=True)
    )
    segments = Segments(
        apex_face=jnp.stack([point.face for point in apexes]),
        apex_barycentric=jnp.stack([point.barycentric for point in apexes]),
        target_face=face,
        target_barycentric=barycentric,
        infinite=infinite,
        direction=direction,
        weight=jnp.ones_like(direction),
        visible=jnp.ones_like(infinite),
    )
    return jax.lax.stop_gradient(segments)


def moved_contributions(packed: PackedScene, drawn: Drawn, moved: Float[Array, "L M 3"]) -> Float[Array, "C M 3"]:
    """Contributions of M pairs of subpaths by each strategy, visible or not, as a function of `moved`.

    `moved` are offsets of the targets in the planes of their faces. For targets at infinity they are offsets in planes
    perpendicular to the direction, at the distance `packed.size`. Contributions are over the densities with which the
    paths were drawn, and in the same measure. `drawn` is detached.
    """
    of = layers(drawn)
    paths, inner, power = moved.shape[1], of.inner, 1
    camera = _camera_subpaths(packed, drawn.camera, moved[: of.emitters])
    met = found_emission(packed, camera, power)[0]
    z = ends(packed, camera, inner)
    direct = _moved_sample(packed, _in_a_row(drawn.direct), moved[of.emitters : of.connections].reshape(-1, 3))
    joined = [with_emitters(packed, z, direct, power).value]

    start = _moved_sample(packed, drawn.start, moved[of.light])
    chain = _light_subpaths(packed, start, drawn, moved[of.light + 1 :])
    pairs = joined_vertices(inner)
    if pairs:
        lasts = [j for _, j in pairs]
        lit = _last_vertices(packed, start, chain, drawn, lasts, moved[of.connections : of.light])
        joined.append(with_each_other(z.rows([i for i, _ in pairs]), _alone(packed, lit, paths), power).value)
    seen = _last_vertices(packed, start, chain, drawn, list(range(inner)), jnp.zeros_like(moved[:inner]))
    lens = None if drawn.lens is None else drawn.lens.reshape(-1, 2)
    joined.append(with_camera(packed, _alone(packed, seen, paths), lens, power)[0].value)
    return jnp.concatenate([met, jnp.concatenate(joined).reshape(-1, paths, 3)])


def _in_a_row(tree):
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), tree)


def _alone(packed: PackedScene, vertex: Subpath, paths: int) -> Ends:
    return Ends(vertex, Scatterer(packed, vertex.point, vertex.back), paths)


def _moved_direction(packed: PackedScene, direction, moved):
    return normalize(packed.size * direction + moved)


def _moved_sample(packed: PackedScene, sample: EmitterSample, moved) -> EmitterSample:
    point, direction, radiance = displaced(packed, sample.point, moved), sample.direction, sample.radiance
    if packed.glow:
        radiance = jnp.where(sample.infinite[:, None], radiance, surface_radiance(packed, point))
    if packed.environment is not None:
        infinite = sample.infinite[:, None]
        direction = jnp.where(infinite, _moved_direction(packed, jnp.where(infinite, direction, 1.0), moved), direction)
        if packed.has_varying_sky:
            radiance = jnp.where(infinite, environment_radiance(packed, direction), radiance)
    return sample._replace(point=point, direction=direction, radiance=radiance)


def _onwards(packed: PackedScene, before: Subpath, after: Subpath, moved, adjoint: bool) -> Subpath:
    """The next vertices of subpaths, themselves `moved`, after vertices that may have moved; see `subpaths.extend`."""
    hit = after.point.valid
    following, point = displaced(packed, after.point, moved), before.point
    away = _moved_direction(packed, -after.back, moved)
    offset = jnp.where(hit[:, None], following.position - point.position, away)
    towards = normalize(offset)
    distance2 = jnp.where(hit, jnp.maximum(dot(offset, offset), 1e-30), 1.0)
    near = point.normal if adjoint else following.normal
    cosine = jnp.abs(dot(near, towards))
    cosine = cosine if adjoint else jnp.where(hit, cosine, 1.0)
    scatterer = Scatterer(packed, point, before.back)
    value = scatterer.seen_from(towards).eval(before.back) if adjoint else scatterer.eval(towards)
    return _arrived(after, following, towards, before.throughput * value * (cosine / distance2)[:, None], before)


def _arrived(after: Subpath, following: SurfacePoint, towards, carried, before: Subpath | None = None) -> Subpath:
    """`after` at the point `following`, reached in direction `towards`, with the throughput `carried` / density."""
    reached = (after.density > 0) & (after.throughput != 0).any(-1)
    if before is not None:
        reached = reached & before.point.valid
    throughput = carried / jnp.where(reached, after.density, 1.0)[:, None]
    throughput = jnp.where(reached[:, None], throughput, 0.0)
    return after._replace(point=following, back=-towards, throughput=throughput)


def _camera_subpaths(packed: PackedScene, camera: Subpath, moved) -> Subpath:
    first = jax.tree.map(lambda a: a[0], camera)
    rest = jax.tree.map(lambda a: a[1:], camera)

    def step(before, following):
        vertex, offset = following
        after = _onwards(packed, before, vertex, offset, False)
        return after, after

    _, others = loops.scan(step, first, (rest, moved))
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), first, others)


def _first_lit(packed: PackedScene, start: EmitterSample, after: Subpath, moved) -> Subpath:
    """First vertices from emitter samples that may have moved, themselves `moved`; see `subpaths.light_start`."""
    following, infinite = displaced(packed, after.point, moved), start.infinite
    offset = jnp.where(infinite[:, None], -start.direction, following.position - start.point.position)
    towards = normalize(offset)
    distance2 = jnp.where(infinite, 1.0, jnp.maximum(dot(offset, offset), 1e-30))
    leaving = jnp.where(infinite, 1.0, jnp.maximum(dot(start.point.normal, towards), 0.0))
    radiance = radiance_towards(packed, start, -towards)
    carried = radiance * safe_divide(leaving / distance2, start.pdf)[:, None]
    return _arrived(after, following, towards, carried)


def _light_subpaths(packed: PackedScene, start: EmitterSample, drawn: Drawn, moved) -> Subpath:
    """Subpaths from emitters without their last vertices, [I - 1, M], `moved`."""
    before = jax.tree.map(lambda a: a[:-1], drawn.light)
    if moved.shape[0] == 0:
        return before
    first = jax.tree.map(lambda a: a[0], before)
    rest = jax.tree.map(lambda a: a[1:], before)
    first = _first_lit(packed, start, first, moved[0])

    def step(before, following):
        vertex, offset = following
        after = _onwards(packed, before, vertex, offset, True)
        return after, after

    _, others = loops.scan(step, first, (rest, moved[1:]))
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), first, others)


def _last_vertices(
    packed: PackedScene, start: EmitterSample, chain: Subpath, drawn: Drawn, lasts: list[int], moved
) -> Subpath:
    """Vertices 1 + j for j in `lasts`, in a row, themselves `moved`, after moved vertices of `start` and `chain`."""

    def pick(tree, rows: list[int]):
        return jax.tree.map(lambda a: jnp.concatenate([a[r] for r in rows]), tree)

    parts: list[tuple[int, Subpath]] = []
    first = [k for k, j in enumerate(lasts) if j == 0]
    later = [k for k, j in enumerate(lasts) if j > 0]
    if first:
        starts = jax.tree.map(lambda a: jnp.concatenate([a] * len(first)), start)
        whole = _first_lit(packed, starts, pick(drawn.light, [0] * len(first)), pick(moved, first))
        parts += _split(whole, first)
    if later:
        before, after = pick(chain, [lasts[k] - 1 for k in later]), pick(drawn.light, [lasts[k] for k in later])
        parts += _split(_onwards(packed, before, after, pick(moved, later), True), later)
    in_order = [part for _, part in sorted(parts, key=lambda part: part[0])]
    return jax.tree.map(lambda *rows: jnp.concatenate(rows), *in_order)


def _split(tree: Subpath, numbers: list[int]) -> list[tuple[int, Subpath]]:
    size = tree.density.shape[0] // len(numbers)
    return [(n, jax.tree.map(lambda a, k=k: a[k * size : (k + 1) * size], tree)) for k, n in enumerate(numbers)]


def rows_of(drawn: Drawn, path: Int[Array, " M"]) -> Drawn:
    """Pairs of subpaths by their numbers."""
    by_vertex = jax.tree.map(lambda a: a[:, path], drawn._replace(start=None))
    return by_vertex._replace(start=jax.tree.map(lambda a: a[path], drawn.start))
