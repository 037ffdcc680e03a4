"""The share of a boundary's velocity that `WarpedArea` finds close to the boundary, by its options.

    python -m experiments.warped_area.approach

It looks at boundary points on the light of `shadow_goathead`, as seen from random points of the floor. They are found
by bisection of chords between two random points of the light, one of them seen and the other hidden. At the last point
that is seen, the hidden auxiliary points should have all of the weight. What they lack is missing in the derivative.
The cost of the options is measured too, by derivative images in turns.
"""

import statistics

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from experiments import common, reference_scenes
from jaxdr.boundary.shared.face_neighbours import connect_faces
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.warped_area.divergence import hidden_velocities
from jaxdr.geometry import queries
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point

CASE, FLOOR, LIGHT = "shadow_goathead", "floor", "light"
CHORDS, DRAWS, BISECTIONS = 20_000, 8, 22
SPP, IMAGES = 32, 8
OPTIONS = [
    {},
    {"boundary_power": 3.0},
    {"spread": 0.35},
    *({"samples": count} for count in (2, 3, 4, 6)),
    {"samples": 16},
    {"samples": 32},
    {"sigma0": 0.02},
    {"sigma0": 0.02, "samples": 16},
    {"sigma0": 0.02, "samples": 32},
]
COLUMNS = {
    "options": ("options", "s"),
    "found at the boundary": ("found", ".3f"),
    "in the worst twentieth": ("worst", ".2f"),
    "projection": ("projection", ".3f"),
    "±": ("uncertainty", ".3f"),
    "deviation of an image": ("deviation", ".2f"),
    "s": ("seconds", ".2f"),
    "deviation² · s": ("work", ".1f"),
}


def drawn(packed, shape, count, rng):
    """(faces, barycentric coordinates, positions) of points uniform by area on a shape."""
    faces = np.flatnonzero(np.asarray(packed.face_shape) == shape)
    corners = np.asarray(packed.vertices, float)[np.asarray(packed.faces)[faces]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    barycentric = rng.dirichlet(np.ones(3), count)
    return faces[chosen], barycentric, np.einsum("nk,nkj->nj", barycentric, corners[chosen])


def boundary_points(packed, floor, light, count, seed=0):
    """Apexes (faces, barycentric coordinates) and the last points of the light that they see beside a boundary."""
    rng = np.random.default_rng(seed)

    @jd.jit
    def hidden(origin, target):
        reach = jnp.full(len(origin), 0.9989, origin.dtype)
        start = origin + 1e-4 * (target - origin)
        return queries.closest_hit(packed.geometry, queries.Rays(start, target - origin, reach)).face >= 0

    def is_hidden(origin, target):
        return np.asarray(hidden(*(jnp.asarray(a, jnp.float32) for a in (origin, target))))

    face, barycentric, apex = drawn(packed, floor, count, rng)
    one, other = (drawn(packed, light, count, rng)[2] for _ in range(2))
    first, second = is_hidden(apex, one), is_hidden(apex, other)
    use = first != second
    face, barycentric, apex, one, other, first = (a[use] for a in (face, barycentric, apex, one, other, first))
    seen, beyond = (np.where((first == h)[:, None], other, one) for h in (True, False))
    for _ in range(BISECTIONS):
        middle = (seen + beyond) / 2
        dark = is_hidden(apex, middle)[:, None]
        seen, beyond = np.where(dark, seen, middle), np.where(dark, middle, beyond)
    return face, barycentric, seen


def face_at(packed, shape, points):
    """Faces of a shape that points lie on."""
    faces = np.flatnonzero(np.asarray(packed.face_shape) == shape)
    a, b, c = np.moveaxis(np.asarray(packed.vertices, float)[np.asarray(packed.faces)[faces]], 1, 0)
    normal = np.cross(b - a, c - a)
    sides = [np.einsum("fj,nfj->nf", normal, np.cross(q - o, points[:, None] - o)) for o, q in ((a, b), (b, c), (c, a))]
    inside = np.min(sides, axis=0) / np.einsum("fj,fj->f", normal, normal)
    return faces[inside.argmax(1)]


def found_at(packed, points, light, estimator):
    """Weight of hidden auxiliary points at boundary points: mean over draws."""
    face, barycentric, seen = points
    faces, on, face = connect_faces(packed), face_at(packed, light, seen), jnp.asarray(face)
    corners, count = packed.vertices[packed.faces[on]], len(face)

    @jd.jit
    def shares(key):
        apex = material_point(packed, face, jnp.asarray(barycentric, jnp.float32), jnp.ones(count, bool))
        target, far = jnp.asarray(seen, jnp.float32), jnp.zeros(count, bool)
        ends = SegmentEnds(apex.position, apex.face, target, faces.normal[on], jnp.asarray(on), corners, far)
        around = estimator.around(packed, True, False)
        v = hidden_velocities(packed, faces, apex, ends, jnp.ones(count, bool), around, key)
        used = jnp.arange(len(v.slots)) < v.used
        return jnp.zeros(count).at[v.row(v.slots)].add(jnp.where(used, v.share[v.slots], 0.0))

    return np.mean([np.asarray(shares(jax.random.key(i))) for i in range(DRAWS)], axis=0)


def cost(reference, estimators, images):
    """For every estimator what derivative images tell, of `images` each, made in turns."""
    tracers = [jd.PathTracer(reference.max_depth, estimator) for estimator in estimators]
    functions = [reference.derivative(tracer, SPP) for tracer in tracers]
    for function in functions:
        jax.block_until_ready(function(jax.random.key(images)))
    made = [[common.seconds_of(f, jax.random.key(i)) for f in functions] for i in range(images)]
    power = np.mean(reference.image**2) - reference.noise**2
    for k in range(len(functions)):
        derivatives = np.stack([np.asarray(turn[k][0], float) for turn in made])
        projections = (derivatives * reference.image).mean((1, 2, 3)) / power
        deviation = float(np.sqrt(derivatives.var(0, ddof=1).mean() / power))
        seconds = statistics.median(turn[k][1] for turn in made)
        yield {
            "projection": float(projections.mean()),
            "uncertainty": float(projections.std(ddof=1) / len(projections) ** 0.5),
            "deviation": deviation,
            "seconds": seconds,
            "work": deviation**2 * seconds,
        }


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--images", type=int, default=IMAGES, help="derivative images per option; 0: no costs")
    options = parser.parse_args()
    chords, images, chosen = (2000, 2, OPTIONS[:2]) if options.quick else (CHORDS, options.images, OPTIONS)
    reference = reference_scenes.load(options.oracle / CASE)
    packed, names = pack(reference.scene), list(reference.scene.shapes)
    floor, light = (names.index(n) for n in (FLOOR, LIGHT))
    points = boundary_points(packed, floor, light, chords)
    estimators, rows = [jd.WarpedArea(**given) for given in chosen], []
    for given, estimator in zip(chosen, estimators, strict=True):
        found = found_at(packed, points, light, estimator)
        name = ", ".join(f"{a}={v:g}" for a, v in given.items()) or "(default)"
        rows.append({"options": name, "found": float(found.mean()), "worst": float(np.quantile(found, 0.05))})
        print(f"{name}: {rows[-1]['found']:.3f}", flush=True)
    if images:
        for row, measured in zip(rows, cost(reference, estimators, images), strict=True):
            row.update(measured)
    folder = common.results("warped_area", options.quick)
    common.write_json(folder / "approach.json", {"points": len(points[0]), "spp": SPP, "images": images, "rows": rows})
    (folder / "approach.md").write_text(common.table(rows, COLUMNS) + "\n")
    print(common.table(rows, COLUMNS))


if __name__ == "__main__":
    main()
