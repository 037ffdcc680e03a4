"""Where a reconstruction starts: hull, sphere, paint, and photographs cut to size."""

import dataclasses
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.optimize.reconstruction import hull
from jaxdr.optimize.reconstruction.atlas import covered, interpolated, unwrapped
from jaxdr.optimize.reconstruction.hull import initial_surface
from jaxdr.optimize.reconstruction.paint import first_light_and_albedo, painted, seen_colors
from jaxdr.optimize.reconstruction.pictures import Pose, cuts
from jaxdr.optimize.reconstruction.sky import TO_WORLD, directions, solid_angles
from jaxdr.scene.camera import look_at
from jaxdr.views.pictures import Pixels
from jaxdr.views.record import View
from tests.views.folders import write_nerf

RADIUS, CENTRE, SIZE, FOCAL = 0.3, np.array([0.2, -0.1, 0.4]), 64, 80.0


def view_of_a_ball(direction, paint=lambda point: np.ones(3), aside=(0.0, 0.0)) -> View:
    """A photograph of a ball, by exact rays."""
    eye = CENTRE + 2.0 * np.asarray(direction, float) / np.linalg.norm(direction)
    pose = look_at(eye, CENTRE, (0.1, 0.2, 1))
    centre = (SIZE / 2 + aside[0], SIZE / 2 + aside[1])
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    local = np.stack([(centre[0] - x) / FOCAL, (centre[1] - y) / FOCAL, np.ones_like(x)], -1)
    ray = local @ pose[:3, :3].T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ (CENTRE - eye)
    depth = RADIUS**2 - (((CENTRE - eye) ** 2).sum() - along**2)
    hit = depth > 0
    point = eye + (along - np.sqrt(np.maximum(depth, 0)))[..., None] * ray
    image = np.where(hit[..., None], np.apply_along_axis(paint, -1, point), 0.0).astype(np.float32)
    return View("ball", Path("ball.png"), Pixels(image, hit.astype(np.float32)), pose, FOCAL, centre)


def all_around(**settings) -> list[View]:
    directions = np.random.default_rng(1).normal(size=(24, 3))
    return [view_of_a_ball(direction, **settings) for direction in directions]


@pytest.mark.parametrize("aside", [(0.0, 0.0), (5.0, -7.0)])
def test_the_hull_of_a_ball_is_the_ball(aside):
    mesh, pose = initial_surface(all_around(aside=aside), "hull", 48)
    points = np.asarray(mesh.vertices) * pose.scale + pose.centre
    distance = np.linalg.norm(points - CENTRE, axis=1)
    assert mesh.closed
    assert abs(np.median(distance) - RADIUS) < 0.02 * RADIUS
    # A hull is never smaller than the object, but for the grid; 24 outlines leave corners.
    assert distance.min() > 0.97 * RADIUS and distance.max() < 1.15 * RADIUS
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    assert np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0
    np.testing.assert_allclose(np.ptp(np.asarray(mesh.vertices), axis=0).max(), 1, atol=1e-5)


def test_a_surface_through_nodes_of_the_grid_has_no_faces_without_area():
    """Such a mesh would draw warnings about faces without area and edges that lie on others."""
    nodes = np.stack(np.meshgrid(*[np.arange(-6.0, 7.0)] * 3, indexing="ij"), -1)
    values = 5.0 - np.linalg.norm(nodes, axis=-1)
    assert (values == 0).sum() > 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = jd.Mesh(*hull.surface_of(values, np.zeros(3), np.ones(3)))
    assert mesh.closed


def test_masks_without_a_common_volume_and_hulls_without_masks_are_refused(tmp_path):
    views = all_around()
    away = np.roll(views[0].alpha, 25, axis=1)
    with pytest.raises(ValueError, match="no volume in common"):
        initial_surface([views[0].with_picture(views[0].image, away), *views[1:]], "hull", 48)
    bare = jd.load_views(write_nerf(tmp_path, alpha=False))
    with pytest.raises(ValueError, match=r"start\.kind"):
        initial_surface(bare.fitted, "hull", 48)


def test_the_sphere_is_where_the_cameras_look():
    mesh, pose = initial_surface(all_around(), "sphere", 48)
    np.testing.assert_allclose(pose.centre, CENTRE, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(np.asarray(mesh.vertices), axis=1), 0.5, atol=1e-5)
    assert 0.5 < pose.scale < 1.0  # the frame is 1.6 wide at the object


def test_cuts_keep_the_projection():
    views = all_around(aside=(9.0, 4.0))
    pose = Pose(CENTRE, 2 * RADIUS)
    for resolution, scale in ((64, 1.0), (32, 0.5)):
        made = cuts(views, pose, resolution)
        height, width, _ = made[0].color.shape
        assert height < resolution and width < resolution
        for cut in made:
            # The centre of the ball lies at the middle of its outline, and the outline fills most of the window.
            rows, columns = np.nonzero(cut.alpha > 0.5)
            x, y = np.asarray(cut.camera.camera(jd.Film(width, height)).project(jnp.zeros((1, 3))))[0]
            assert abs(x - columns.mean() - 0.5) < 0.7 and abs(y - rows.mean() - 0.5) < 0.7
            outline = 2 * FOCAL * scale * RADIUS / np.sqrt(4 - RADIUS**2)
            assert abs(np.ptp(columns) + 1 - outline) < 2


def test_reduced_pictures_keep_the_light():
    views = all_around()
    full, half = (cuts(views, Pose(CENTRE, 0.6), resolution) for resolution in (64, 32))
    for one, other in zip(full, half, strict=True):
        np.testing.assert_allclose(one.color.sum() / 4, other.color.sum(), rtol=1e-4)
        np.testing.assert_allclose(one.alpha.sum() / 4, other.alpha.sum(), rtol=1e-4)


def test_colours_at_the_border_of_a_mask_are_not_trusted():
    view = all_around()[0]
    (cut,) = cuts([view], Pose(CENTRE, 0.6), 64)  # a picture with its background, and a mask
    (bare,) = cuts([dataclasses.replace(view, backdrop=False)], Pose(CENTRE, 0.6), 64)
    assert (bare.trust == 1).all() and 0.05 < (cut.trust == 0).mean() < 0.3
    inside, outside = cut.alpha[cut.trust == 1] == 1, cut.alpha[cut.trust == 1] == 0
    assert inside.any() and outside.any() and (inside | outside).all()


def test_paint_is_what_the_photographs_show():
    def paint(point):
        return np.array([0.6, 0.2, 0.1]) if point[2] > CENTRE[2] else np.array([0.1, 0.2, 0.6])

    mesh = shapes.sphere(3, radius=0.5).smooth()
    colors = seen_colors(mesh, cuts(all_around(paint=paint), Pose(CENTRE, 2 * RADIUS), 64))
    z = np.asarray(mesh.vertices)[:, 2]
    upper, lower = colors[z > 0.08], colors[z < -0.08]
    np.testing.assert_allclose(upper, np.broadcast_to([0.6, 0.2, 0.1], upper.shape), atol=0.01)
    np.testing.assert_allclose(lower, np.broadcast_to([0.1, 0.2, 0.6], lower.shape), atol=0.01)


def test_a_texture_shows_paint_between_the_vertices():
    pytest.importorskip("xatlas")

    def paint(point):  # rings that are finer than the mesh
        return np.full(3, 0.6 if np.sin(20 * np.arcsin(np.clip((point[2] - CENTRE[2]) / RADIUS, -1, 1))) > 0 else 0.3)

    mesh = unwrapped(shapes.sphere(2, radius=0.5).smooth(), 128)
    photographs = cuts(all_around(paint=paint), Pose(CENTRE, 2 * RADIUS), 64)
    at_vertices = seen_colors(mesh, photographs)
    texels = covered(mesh, 128)
    wanted = np.apply_along_axis(paint, 1, CENTRE + 2 * RADIUS * interpolated(mesh, texels, np.asarray(mesh.vertices)))
    texture = painted(mesh, at_vertices, at_vertices, photographs, 128).reshape(-1, 3)[texels.index]
    coarse = interpolated(mesh, texels, at_vertices)
    assert np.abs(texture - wanted).mean() < 0.4 * np.abs(coarse - wanted).mean()


def test_what_no_photograph_shows_gets_the_colour_of_the_rest():
    mesh = shapes.sphere(2, radius=0.5).smooth()
    colors = seen_colors(mesh, cuts([view_of_a_ball((0, 0, 1))], Pose(CENTRE, 2 * RADIUS), 64))
    np.testing.assert_allclose(colors, 1.0, atol=1e-6)


def test_shading_is_told_from_paint():
    # A white lamp from above, a surface of two paints in patches: light explains the shading, albedo the patches.
    mesh = shapes.sphere(4, radius=0.5).smooth()
    normals = np.asarray(mesh.vertex_normals(), float)
    patches = np.where(np.sin(15 * normals[:, :1]) * np.sin(15 * normals[:, 1:2]) > 0, 1.0, 0.5)
    lit = 0.15 + np.maximum(normals @ [0.0, 0.6, 0.8], 0.0)
    albedo = patches * [0.5, 0.4, 0.2]
    light, found = first_light_and_albedo(mesh, albedo * lit[:, None], None)
    assert (light >= 0).all() and np.ptp(light, axis=2).max() == 0
    scale = (found * albedo).sum() / (found**2).sum()
    raw = albedo * lit[:, None]
    raw_scale = (raw * albedo).sum() / (raw**2).sum()
    error, raw_error = np.abs(scale * found - albedo).mean(), np.abs(raw_scale * raw - albedo).mean()
    assert error < 0.35 * raw_error
    towards = (light[..., :1] * directions(len(light)) * solid_angles(len(light))[..., None]).sum((0, 1))
    towards = TO_WORLD[:3, :3] @ (towards / np.linalg.norm(towards))
    assert towards @ [0.0, 0.6, 0.8] > 0.9
