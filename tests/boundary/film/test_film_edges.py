"""Edges seen directly: derivatives of the mean of an image against areas of clipped polygons.

Before a white sky a black polygon takes its projected area off the sum of the image, so its derivative is known: only
silhouettes count. The reference clips in float64 and differentiates by central differences.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments import one_term
from jaxdr.boundary.film import film_edges
from jaxdr.boundary.film.film_edges import KINDS, FilmEdges
from jaxdr.geometry.shapes import box, rectangle
from jaxdr.scene.packed import pack
from jaxdr.transport.path_settings import PathSettings
from tests.references.central_differences import central
from tests.references.polygon_shadow import irradiance

SIZE = 16
NEAR = 1e-2
LOOK = jd.look_at([0, 0, 0], [0, 0, 1], [0, 1, 0])  # x to the left, y up, z forward
QUAD = [[0, 1, 2], [0, 2, 3]]
SQUARE = np.array([[-0.5, -0.4, 2.0], [0.6, -0.4, 2.0], [0.6, 0.5, 2.0], [-0.5, 0.5, 2.0]])


def film(crop=None):
    return jd.Film(SIZE, SIZE, jd.Box(), crop)


def scene(quads: dict, crop=None) -> jd.Scene:
    """Black quadrangles before a white sky."""
    shapes = {name: jd.Shape(jd.Mesh(corners, QUAD), jd.Diffuse(0.0)) for name, corners in quads.items()}
    return jd.Scene(shapes, jd.Perspective(LOOK, 60.0, film(crop), near_clip=NEAR), jd.ConstantEnvironment(1.0))


def clip(polygon, normal, offset):
    """Part of a polygon with normal · x >= offset."""
    out = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        fa, fb = a @ normal - offset, b @ normal - offset
        if fa >= 0:
            out.append(a)
        if (fa < 0) != (fb < 0):
            out.append(a + fa / (fa - fb) * (b - a))
    return np.array(out).reshape(-1, polygon.shape[1])


def outline(corners, window=(0, 0, SIZE, SIZE)):
    """Projection of a planar quadrangle onto the film, in pixels, clipped to the near plane and the window."""
    corners = clip(np.asarray(corners, float), np.array([0.0, 0.0, 1.0]), NEAR)
    if len(corners) < 3:
        return np.zeros((0, 2))
    focal = 0.5 * SIZE / np.tan(np.deg2rad(30.0))
    polygon = SIZE / 2 - focal * corners[:, :2] / corners[:, 2:]
    x0, y0, width, height = window
    for normal, offset in (([1, 0], x0), ([-1, 0], -x0 - width), ([0, 1], y0), ([0, -1], -y0 - height)):
        polygon = clip(polygon, np.array(normal, float), offset)
    return polygon


def signed_area(polygon):
    if len(polygon) < 3:
        return 0.0
    x, y = polygon.T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))


def union_area(first, second, window=(0, 0, SIZE, SIZE)):
    """Area covered by two convex quadrangles on the film."""
    first, second = outline(first, window), outline(second, window)
    common = second
    turn = np.sign(signed_area(first)) if len(first) else 1.0
    for a, b in zip(first, np.roll(first, -1, axis=0), strict=True):
        inward = turn * np.array([-(b - a)[1], (b - a)[0]])
        common = clip(common, inward, inward @ a) if len(common) else common
    return abs(signed_area(first)) + abs(signed_area(second)) - abs(signed_area(common))


edge_distribution = jax.jit(film_edges.edge_distribution, static_argnums=(1, 3))
INTEGRATOR, SETTINGS = jd.PathTracer(max_depth=1, edge_samples=4.0), PathSettings(2, True, "auto")


@jax.jit
def mean_gradient(of: jd.Scene, key):
    """Derivative of the sum of the image over pixels, channels averaged, with respect to all vertices."""
    vertices = {name: value for name, value in of.parameters().items() if name.endswith(".vertices")}

    def total(vertices):
        return jd.render(of.replace(vertices), key, spp=4, integrator=INTEGRATOR).mean(-1).sum()

    return jax.grad(total)(vertices)


def estimate(of: jd.Scene, keys=12):
    """Mean over keys and standard error, by shape."""
    rows = [jax.device_get(mean_gradient(of, key)) for key in jax.random.split(jax.random.key(0), keys)]
    stacked = {name.split(".")[0]: np.stack([row[name] for row in rows]) for name in rows[0]}
    return {n: (a.mean(0), a.std(0, ddof=1) / np.sqrt(keys)) for n, a in stacked.items()}


def assert_derivative(found, exact, precision=0.02):
    mean, error = found
    scale = np.abs(exact).max()
    assert np.all(error < precision * scale), f"too noisy: ± {error.max() / scale}"
    assert np.all(np.abs(mean - exact) < 4.5 * error + 2e-3 * scale), f"{mean} ± {error}, exactly\n{exact}"


CASES = {
    "inside": SQUARE,
    "tilted": SQUARE + np.outer([0.5, -0.6, -0.6, 0.5], [0, 0, 1]),
    "across the border": SQUARE + np.array([0.9, 0.2, 0.0]),
    "around the film": SQUARE * [1.0, 9.0, 1.0],
    # Two corners behind the camera: the near plane cuts a floor that reaches under the camera.
    "partly behind": np.array([[-0.7, -0.5, -1.0], [0.6, -0.5, -1.0], [0.6, -0.5, 3.0], [-0.7, -0.5, 3.0]]),
    "one corner behind": np.array([[-0.9, -0.4, -0.5], [0.6, -0.7, 2.0], [0.5, 0.4, 3.0], [-1.0, 0.7, 0.5]]),
}


@pytest.mark.parametrize("case", CASES)
def test_black_quadrangle_before_a_white_sky(case):
    corners = CASES[case]
    # The reference keeps the quadrangle's outline for corners that leave their plane: with thin triangles it is exact.
    exact = -central(lambda c: abs(signed_area(outline(c))), corners)
    assert_derivative(estimate(scene({"quad": corners}))["quad"], exact, 0.05)


def test_perimeter_times_velocity():
    """A square that grows: the image loses its perimeter times the speed of its sides."""
    half = 0.6
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [0, 0, 2.0]
    mean, error = estimate(scene({"quad": corners}))["quad"]
    outwards = np.sign(corners * [1, 1, 0])
    pixels = 0.5 * SIZE / np.tan(np.deg2rad(30.0)) / 2.0  # per unit of length at this distance
    perimeter = 8 * half * pixels
    assert abs(np.sum(mean * outwards) + perimeter * pixels) < 0.003 * perimeter * pixels + 4 * np.sum(error)


def test_crop_window():
    """Edges outside of the window don't count, those across its border in part."""
    window = (5, 2, 6, 9)
    exact = -central(lambda c: abs(signed_area(outline(c, window))), SQUARE)
    assert_derivative(estimate(scene({"quad": SQUARE}, crop=window))["quad"], exact, 0.05)


def test_partly_hidden_edges():
    """Two overlapping quadrangles at different distances: edges of the farther one count where they are seen."""
    near = SQUARE * [0.6, 0.5, 0.7] + [0.25, 0.15, 0.0]
    found = estimate(scene({"far": SQUARE, "near": near}))
    assert_derivative(found["far"], -central(lambda c: union_area(c, near), SQUARE), 0.05)
    assert_derivative(found["near"], -central(lambda c: union_area(SQUARE, c), near), 0.05)


@pytest.mark.filterwarnings("ignore:Mesh")
def test_edges_on_one_another_count_once():
    """A square that is there twice, without sharing vertices: both copies together; apart each on its own."""
    mesh = jd.Mesh(np.vstack([SQUARE, SQUARE]), np.vstack([QUAD, np.add(QUAD, 4)]))
    of = jd.Scene({"quad": jd.Shape(mesh, jd.Diffuse(0.0))}, scene({"q": SQUARE}).camera, jd.ConstantEnvironment(1.0))
    mean, error = estimate(of)["quad"]
    exact = -central(lambda c: abs(signed_area(outline(c))), SQUARE)
    assert_derivative((mean[:4] + mean[4:], error[:4] + error[4:]), exact, 0.08)
    assert_derivative((mean[4:], error[4:]), 0.5 * exact, 0.08)
    aside = SQUARE + np.array([0.4, 0.1, 0.3])
    mean, error = estimate(of.replace({"quad.vertices": np.vstack([aside, SQUARE])}))["quad"]
    assert_derivative((mean[4:], error[4:]), -central(lambda c: union_area(aside, c), SQUARE), 0.08)


def test_hidden_edges_contribute_nothing():
    behind = SQUARE * [0.5, 0.5, 1.0] + [0, 0, 2.0]
    found = estimate(scene({"front": SQUARE, "behind": behind}), keys=4)
    assert np.all(found["behind"][0] == 0) and np.any(found["front"][0] != 0)


def test_behind_the_camera_is_nothing():
    found = estimate(scene({"front": SQUARE, "behind": SQUARE * [1, 1, -1]}), keys=4)
    assert np.all(found["behind"][0] == 0) and np.any(found["front"][0] != 0)


def test_edges_without_a_jump_are_left_out():
    """The diagonal of a flat quadrangle; of a closed box the edges that are silhouettes or creases remain."""
    packed = pack(scene({"quad": SQUARE}))
    found = edge_distribution(packed, (True,), jax.random.key(0), SETTINGS)
    importance = found.importance[found.edge >= 0]
    diagonal = (np.asarray(packed.edges.faces) >= 0).all(1)
    assert diagonal.sum() == 1
    np.testing.assert_array_equal(np.asarray(importance) > 0, ~diagonal)
    standing = jd.Scene(
        {"quad": jd.Shape(rectangle()), "box": jd.Shape(box(center=(0.0, 0.0, 3.0)))}, scene({"q": SQUARE}).camera
    )
    # Shapes come sorted by their names: the box is the first.
    for moving in ((True, False), (False, True)):
        found = edge_distribution(pack(standing), moving, jax.random.key(0), SETTINGS)
        shape = np.asarray(pack(standing).edges.shape)
        np.testing.assert_array_equal(found.edge[found.edge >= 0], np.flatnonzero(np.asarray(moving)[shape]))
        assert found.importance.shape == found.edge.shape and np.any(np.asarray(found.importance) > 0)


def test_edges_of_what_stands_still_change_nothing():
    """The same rows with and without other shapes that move, but for what is typical of the light."""
    shapes = {
        "a": jd.Shape(box(center=(-1.0, 0.0, 4.0))),
        "b": jd.Shape(rectangle(3.0, 3.0, (0.0, 0.0, 6.0))),
        "c": jd.Shape(box((0.5, 0.7, 0.9), center=(1.0, 0.2, 4.0))),
    }
    packed = pack(jd.Scene(shapes, scene({"q": SQUARE}).camera))
    every = edge_distribution(packed, (True, True, True), jax.random.key(0), SETTINGS)
    for moving in ((True, False, True), (False, False, True), (True, False, False)):
        found = edge_distribution(packed, moving, jax.random.key(0), SETTINGS)
        rows = np.asarray(found.edge)
        rows = rows[rows >= 0]
        for name in ("start", "end", "clip", "homogeneous", "range"):
            np.testing.assert_array_equal(getattr(found, name)[: len(rows)], np.asarray(getattr(every, name))[rows])
        sides = [np.diff(np.asarray(d.silhouettes), prepend=0) > 0 for d in (found, every)]
        np.testing.assert_array_equal(sides[0][: len(rows)], sides[1][rows])
        assert sides[0].any()


# A lit box that turns: creases.

LIGHT = np.array([[-2.5, -2.5, 4.0], [-2.5, -1.0, 4.0], [-0.5, -1.0, 3.0], [-0.5, -2.5, 3.0]])
EYE = jd.look_at([1.5, -5.0, 2.0], [0, 0, 0], [0, 0, 1])
BOX = box((1.0, 1.0, 1.0))


def turned(angle, vertices, library=np):
    c, s = library.cos(angle), library.sin(angle)
    x, y, z = vertices[:, 0], vertices[:, 1], vertices[:, 2]
    return library.stack([c * x - s * y, s * x + c * y, z], 1)


def lit_box_sum(angle, nodes=12):
    """Sum of the image of the turned box by quadrature over its visible faces, in closed form at every node."""
    vertices = turned(angle, np.asarray(BOX.vertices, float))
    focal, rotation, eye = 0.5 * SIZE / np.tan(np.deg2rad(10.0)), EYE[:3, :3], EYE[:3, 3]
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2, w / 2
    total = 0.0
    for a, b, c in vertices[np.asarray(BOX.faces)]:
        normal = np.cross(b - a, c - a)
        if normal @ (eye - a) <= 0:
            continue
        # Area of film per area of the face: focal² n · (eye - p) / depth³.
        for u, wu in zip(x, w, strict=True):
            for v, wv in zip(x, w, strict=True):
                p = a + u * (b - a) + u * v * (c - b)
                depth = (p - eye) @ rotation[:, 2]
                light = irradiance(p, normal / np.linalg.norm(normal), LIGHT)
                total += wu * wv * u * focal**2 * (normal @ (eye - p)) / depth**3 * light
    return 0.5 / np.pi * total


LIT_BOX = jd.Scene(
    {
        "box": jd.Shape(BOX, jd.Diffuse(0.5)),
        "light": jd.Shape(jd.Mesh(LIGHT, QUAD), jd.Diffuse(0.0), jd.AreaEmitter(1.0)),
    },
    jd.Perspective(EYE, 20.0, jd.Film(SIZE, SIZE, jd.Box())),
)


@jax.jit
def lit_box_derivative(key):
    """Sums of the terms over the image, and their derivatives as the box turns."""

    def sums(angle):
        moved = LIT_BOX.replace({"box.vertices": turned(angle, BOX.vertices, jnp)})
        terms = jd.derivative_terms(moved, key, spp=32, integrator=jd.PathTracer(max_depth=2, edge_samples=1.0))
        return jax.tree.map(lambda t: t.mean(-1).sum(), terms)

    return jax.jvp(sums, (jnp.asarray(0.3),), (jnp.asarray(1.0),))


def test_creases_of_a_turning_box():
    """Interior, silhouettes and creases add up; without creases the sum is wrong."""
    value, exact = lit_box_sum(0.3), (lit_box_sum(0.3 + 1e-4) - lit_box_sum(0.3 - 1e-4)) / 2e-4
    rows = [jax.device_get(lit_box_derivative(key)) for key in jax.random.split(jax.random.key(1), 12)]
    radiance = np.array([row[0]["interior"] for row in rows])
    assert abs(radiance.mean() - value) < 4 * radiance.std() / np.sqrt(11) + 1e-4 * value
    assert all(row[0][name] == 0 for row in rows for name in ("silhouettes", "creases", "boundary"))
    terms = {name: np.array([row[1][name] for row in rows]) for name in rows[0][1]}
    total = sum(terms.values())
    mean, error = total.mean(), total.std(ddof=1) / np.sqrt(12)
    assert error < 0.05 * abs(exact), (mean, error, exact)
    assert abs(mean - exact) < 4.5 * error, f"{mean} ± {error}, exactly {exact}"
    assert abs(terms["creases"].mean()) > 6 * error, {n: t.mean() for n, t in terms.items()}


@partial(jax.jit, static_argnums=0)
def edge_derivative(kinds, key):
    """Derivative of the image's sum, of the edges of some kinds alone, as the box turns."""
    term = FilmEdges(*kinds)
    moving = tuple(name == "box" for name in LIT_BOX.shapes)

    def moved(angle):
        return one_term.context(LIT_BOX.replace({"box.vertices": turned(angle, BOX.vertices, jnp)}), moving, SETTINGS)

    state = term.prepare(moved(jnp.asarray(0.3)), jax.random.key(0))

    def total(angle):
        return one_term.image(term, moved(angle), state, 16, key).mean(-1).sum()

    return jax.jvp(total, (jnp.asarray(0.3),), (jnp.asarray(1.0),))[1]


def test_both_kinds_of_edges_add_up_to_the_one_term():
    keys = jax.random.split(jax.random.key(2), 12)
    rows = {kinds: [float(edge_derivative(kinds, key)) for key in keys] for kinds in ((), *((kind,) for kind in KINDS))}
    means = {kinds: np.mean(found) for kinds, found in rows.items()}
    error = np.sqrt(sum(np.var(found, ddof=1) / len(keys) for found in rows.values()))
    size = max(abs(mean) for mean in means.values())
    assert all(abs(means[(kind,)]) > 6 * error for kind in KINDS), (means, error)
    assert error < 0.05 * size and abs(means[()] - sum(means[(kind,)] for kind in KINDS)) < 4.5 * error, (means, error)
