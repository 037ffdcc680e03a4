"""Cameras: conventions, projection as the inverse of rays, and what is seen through an aperture."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.sampling import uniform_disk

ORIGIN, TARGET, UP = (1.0, -3.0, 2.0), (0.2, 0.1, 0.3), (0.0, 0.0, 1.0)
RNG = np.random.default_rng(0)


def pose(*scale) -> np.ndarray:
    return jd.look_at(ORIGIN, TARGET, UP) @ np.diag([*scale, 1.0])


def camera(width=40, height=30, fov=50.0, fov_axis="x", scale=1.0, **rest) -> jd.Perspective:
    return jd.Perspective(pose(scale, scale, scale), fov, jd.Film(width, height), fov_axis, **rest)


FILM = jd.Film(40, 30)
CAMERAS = {
    "perspective": lambda: camera(),
    "scaled": lambda: camera(scale=2.5),
    "principal point": lambda: camera(principal_point=(0.2, -0.1)),
    "parallel": lambda: jd.Orthographic(pose(1, 1, 1), FILM),
    "parallel, scaled": lambda: jd.Orthographic(pose(3, 2, 0.5), FILM),
    "lens": lambda: jd.ThinLens(pose(1, 1, 1), 50.0, FILM, 0.2, 3.0),
    "lens, scaled": lambda: jd.ThinLens(pose(2, 2, 2), 50.0, FILM, 0.2, 3.0, principal_point=(0.2, -0.1)),
}
cameras = pytest.mark.parametrize("make", CAMERAS.values(), ids=CAMERAS)
LENS_POINTS = RNG.random((50, 2))


def test_centre_looks_at_the_target():
    origin, direction = camera().rays(jnp.asarray([20.0, 15.0]))
    np.testing.assert_allclose(origin, ORIGIN, rtol=1e-6)
    towards = np.subtract(TARGET, ORIGIN)
    np.testing.assert_allclose(direction, towards / np.linalg.norm(towards), atol=1e-6)


def test_up_is_row_zero_and_right_is_to_the_right():
    _, directions = camera().rays(jnp.asarray([[20.0, 0.0], [40.0, 15.0]]))
    right = np.cross(np.subtract(TARGET, ORIGIN), UP)
    assert directions[0] @ np.asarray(UP) > directions[1] @ np.asarray(UP)
    assert directions[1] @ right > 0


@pytest.mark.parametrize(
    ("fov_axis", "points"),
    [("x", [[0, 15], [40, 15]]), ("y", [[20, 0], [20, 30]]), ("smaller", [[20, 0], [20, 30]]),
     ("larger", [[0, 15], [40, 15]]), ("diagonal", [[0, 0], [40, 30]])],
)  # fmt: skip
def test_field_of_view(fov_axis, points):
    _, (first, second) = camera(fov_axis=fov_axis).rays(jnp.asarray(points, jnp.float32))
    assert abs(np.degrees(np.arccos(float(first @ second))) - 50.0) < 0.01


def test_principal_point_moves_the_image():
    """To the left and up, by shares of the film."""
    points = jnp.asarray(RNG.uniform(-1, 1, (9, 3)), jnp.float32)
    moved = camera(principal_point=(0.25, 0.1)).project(points)
    np.testing.assert_allclose(moved, camera().project(points) - np.array([10.0, 3.0]), atol=2e-5)


def test_parallel_film_covers_two_units_across():
    view = jd.Orthographic(np.eye(4), FILM)
    np.testing.assert_allclose(view.project(jnp.asarray([[1.0, 0.75, 5.0], [-1.0, -0.75, 2.0]])), [[0, 0], [40, 30]])
    origin, direction = view.rays(jnp.asarray([[0.0, 0.0], [30.0, 15.0]]))
    np.testing.assert_allclose(origin, [[1, 0.75, 0], [-0.5, 0, 0]])
    np.testing.assert_allclose(direction, [[0, 0, 1], [0, 0, 1]])


@cameras
def test_projection_inverts_rays(make):
    """Wherever a ray is followed to, and however all parameters of the camera change."""
    with jax.enable_x64(True):
        film_points, distances = jnp.asarray(RNG.uniform([0, 0], [40, 30], (50, 2))), RNG.uniform(0.1, 9, (50, 1))
        leaves, structure = jax.tree.flatten(make())
        tangents = [jnp.asarray(RNG.standard_normal(leaf.shape)) for leaf in leaves]

        def there_and_back(*leaves):
            view = jax.tree.unflatten(structure, leaves).view(jnp.asarray(LENS_POINTS))
            origin, direction = view.rays(film_points)
            return view.project(origin + distances * direction)

        back, change = jax.jvp(there_and_back, leaves, tangents)
        np.testing.assert_allclose(back, film_points, atol=1e-10)
        np.testing.assert_allclose(change, 0.0, atol=1e-8)


@cameras
def test_film_area_is_the_determinant_of_the_projection(make):
    with jax.enable_x64(True):
        view = make().view(jnp.asarray(LENS_POINTS))
        points = jnp.asarray(RNG.uniform(-1, 1, (50, 3)))
        sides = RNG.standard_normal((50, 2, 3))  # a parallelogram at every point
        cross = np.cross(sides[:, 0], sides[:, 1])
        area = np.linalg.norm(cross, axis=-1)
        _, first = jax.jvp(view.project, (points,), (jnp.asarray(sides[:, 0]),))
        _, second = jax.jvp(view.project, (points,), (jnp.asarray(sides[:, 1]),))
        on_film = np.abs(np.linalg.det(np.stack([first, second], -1)))
        found = view.film_area(view.local(points), jnp.asarray(cross / area[:, None]))
        np.testing.assert_allclose(found, on_film / area, rtol=1e-9)


@cameras
def test_rays_come_from_where_points_see_the_camera(make):
    view = make().view(jnp.asarray(LENS_POINTS, jnp.float32))
    film_points = jnp.asarray(RNG.uniform([0, 0], [40, 30], (50, 2)), jnp.float32)
    origin, direction = view.rays(film_points)
    np.testing.assert_allclose(view.towards(origin + 3.0 * direction), -direction, atol=2e-6)
    # A pixel further on the film is the length of a pixel further across the ray, if that is along the axis.
    middle = jnp.broadcast_to(view.centre, (50, 2))
    origin, direction = view.rays(middle)
    beside = view.row(jnp.arange(50)).rays(middle + jnp.asarray([1e-2, 0.0]))
    apart = np.linalg.norm(origin + 3.0 * direction - (beside[0] + 3.0 * beside[1]), axis=-1) / 1e-2
    if np.allclose(*np.linalg.norm(view.matrix, axis=0)[:2]):
        np.testing.assert_allclose(view.pixel_size(origin + 3.0 * direction), apart, rtol=2e-3)


def test_clipped_rays():
    view = camera(near_clip=0.5, far_clip=20.0, scale=2.0).view()
    origin, direction = view.rays(jnp.asarray([[0.0, 0.0], [20.0, 15.0]]))
    start, reach = view.clipped(origin, direction)
    np.testing.assert_allclose(view.local(start)[:, 2], 0.5, rtol=1e-5)
    np.testing.assert_allclose(view.local(start + reach[:, None] * direction)[:, 2], 20.0, rtol=1e-5)


# A lens


def lens(radius=0.2, focus=3.0) -> jd.ThinLens:
    return jd.ThinLens(pose(2, 2, 2), 50.0, FILM, radius, focus)


def at_depth(depth, count=40):
    """World points at a depth of the scaled frame."""
    local = np.concatenate([RNG.uniform(-1, 1, (count, 2)), np.full((count, 1), depth), np.ones((count, 1))], 1)
    return jnp.asarray((local @ pose(2, 2, 2).T)[:, :3], jnp.float32)


def test_sharp_at_the_depth_of_focus():
    points, u = at_depth(3.0), jnp.asarray(RNG.random((40, 2)), jnp.float32)
    np.testing.assert_allclose(lens().view(u).project(points), lens().project(points), atol=1e-4)


@pytest.mark.parametrize("depth", [0.5, 2.0, 8.0])
def test_circle_of_confusion(depth):
    """Film points go from the centre's along with the lens point, as far as `blur` says; f R |1/z - 1/F| pixels."""
    points, u = at_depth(depth), jnp.asarray(RNG.random((40, 2)), jnp.float32)
    moved = lens().view(u).project(points) - lens().project(points)
    focal = 20 / np.tan(np.radians(25))
    expected = focal * 0.2 * (1 / depth - 1 / 3.0)
    np.testing.assert_allclose(lens().blur(lens().local(points)), expected, rtol=1e-4)
    np.testing.assert_allclose(moved, expected * uniform_disk(u), atol=3e-4)


def test_surfaces_that_turn_within_the_aperture():
    points = at_depth(1.0, 200)
    normal = RNG.standard_normal((200, 3))
    normal = jnp.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True), jnp.float32)
    wide = lens(radius=0.7)
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) * 0.7 @ np.asarray(wide.to_world[:3, :3]).T
    facing = ((np.asarray(wide.position) + rim - np.asarray(points)[:, None]) * np.asarray(normal)[:, None]).sum(-1) > 0
    turns = facing.any(1) & ~facing.all(1)
    assert 20 < turns.sum() < 180
    assert np.mean(np.asarray(wide.turns(points, normal)) == turns) > 0.98  # but for the rim's corners


def test_lens_points_are_uniform_in_area():
    points = np.asarray(uniform_disk(jnp.asarray(RNG.random((40000, 2)), jnp.float32)))
    radius, angle = np.hypot(*points.T), np.arctan2(*points.T)
    assert radius.max() <= 1 + 1e-6
    cells, _, _ = np.histogram2d(radius**2, angle, [8, 8], [[0, 1 + 1e-6], [-np.pi, np.pi]])
    assert ((cells - 625) ** 2 / 625).sum() < 63 + 5 * np.sqrt(2 * 63)  # chi²
    assert np.all(np.isfinite(uniform_disk(jnp.asarray([[0.5, 0.5], [0.0, 0.0], [0.5, 0.1]]))))


# Errors


WRONG = {
    "matrix": ({"to_world": np.eye(3)}, "4 x 4 matrix"),
    "sheared": ({"to_world": np.eye(4) + np.eye(4, k=1)}, "may rotate, translate and scale all axes alike"),
    "stretched": ({"to_world": np.diag([2.0, 1, 1, 1])}, "may rotate, translate and scale all axes alike"),
    "flat": ({"to_world": np.diag([1.0, 0, 1, 1])}, "can't be inverted"),
    "infinite": ({"to_world": np.diag([1.0, np.nan, 1, 1])}, "finite"),
    "axis": ({"fov_axis": "z"}, "fov_axis must be one of"),
    "near": ({"near_clip": 0.0}, "0 < near_clip < far_clip"),
    "fov 0": ({"fov": 0.0}, "fov must be between 0 and 180 degrees, got 0.0"),
    "fov 180": ({"fov": 180.0}, "fov must be between 0 and 180 degrees"),
    "principal point": ({"principal_point": 0.1}, "two numbers"),
}


@pytest.mark.parametrize(("arguments", "message"), WRONG.values(), ids=WRONG)
def test_wrong_cameras(arguments, message):
    with pytest.raises(ValueError, match=f"Perspective: .*{message}"):
        jd.Perspective(**({"to_world": np.eye(4), "fov": 40.0, "film": jd.Film(4, 4)} | arguments))


@pytest.mark.parametrize("name", ["aperture_radius", "focus_distance"])
def test_wrong_lenses(name):
    lengths = {"aperture_radius": 0.1, "focus_distance": 1.0} | {name: -1.0}
    with pytest.raises(ValueError, match=f"ThinLens: {name} must be a positive number, got -1"):
        jd.ThinLens(np.eye(4), 40.0, jd.Film(4, 4), **lengths)


def test_wrong_parallel_cameras():
    with pytest.raises(ValueError, match="Orthographic: to_world can't be inverted"):
        jd.Orthographic(np.diag([1.0, 0, 1, 1]), jd.Film(4, 4))
    with pytest.raises(ValueError, match="Orthographic: need 0 < near_clip"):
        jd.Orthographic(np.eye(4), jd.Film(4, 4), near_clip=-1.0)


def test_traced_parameters():
    """What is traced can't be checked."""
    film = jd.Film(4, 4)
    found = jax.jit(lambda fov, pose: jd.Perspective(pose, fov, film).project(jnp.asarray([0.1, 0.2, 1.0])))
    np.testing.assert_allclose(found(90.0, np.eye(4)), [1.8, 1.6], rtol=1e-6)


def test_up_along_the_view():
    with pytest.raises(ValueError, match="parallel to the view direction"):
        jd.look_at((0, 0, 1), (0, 0, 0), (0, 0, 1))
