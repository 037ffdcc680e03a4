"""The light: resampling, and what the backgrounds of photographs show of it."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxdr.optimize.reconstruction.sky import (
    TO_WORLD,
    columns_of,
    directions,
    environment,
    find_backdrop,
    resampled,
    solid_angles,
)
from jaxdr.scene.camera import look_at
from jaxdr.views.pictures import Pixels
from jaxdr.views.record import View

ROWS, SIZE, FOCAL = 9, 48, 40.0


def radiance(direction):
    """A smooth sky."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.stack([0.4 + 0.3 * x, 0.4 + 0.3 * y, 0.4 + 0.3 * z], -1)


def background_views(near: bool = False) -> list[View]:
    """Photographs of the sky, or of a pattern on a sphere close to the cameras, with a small object in front."""
    views = []
    for i in range(12):
        angle = 2 * np.pi * i / 12
        eye = 2 * np.array([np.cos(angle), np.sin(angle), 0.3])
        pose = look_at(eye, (0, 0, 0), (0, 0, 1))
        x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
        local = np.stack([(SIZE / 2 - x) / FOCAL, (SIZE / 2 - y) / FOCAL, np.ones_like(x)], -1)
        ray = local @ pose[:3, :3].T
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        if near:
            noise = np.random.default_rng(i).uniform(0.05, 0.9)
            image = np.full((SIZE, SIZE, 3), noise)
        else:
            image = radiance(ray)
        alpha = (np.hypot(x - SIZE / 2, y - SIZE / 2) < 5).astype(np.float32)
        picture = Pixels(image.astype(np.float32), alpha)
        views.append(View(str(i), Path(f"{i}.png"), picture, pose, FOCAL, (SIZE / 2, SIZE / 2)))
    return views


def test_backgrounds_that_agree_are_the_sky():
    views = background_views()
    found = find_backdrop(views, ROWS)
    known = found.weight > 0
    assert 0.2 < known.mean() < 0.9 and not found.clipped.any()
    light = np.log(np.maximum(found.radiance, 1e-3))
    # Where the map is known all around a direction it is the sky in that direction, through the renderer's look-up.
    direction = np.array([[0.95, 0.0, -0.3], [0.0, 0.9, -0.3]])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    got = np.asarray(environment(jnp.asarray(light, jnp.float32)).eval(jnp.asarray(direction, jnp.float32)))
    np.testing.assert_allclose(got, radiance(direction), atol=0.06)
    # Texels cover finite angles: their means are the sky at their middle but for its curvature.
    middle = radiance(directions(ROWS) @ TO_WORLD[:3, :3].T)
    assert np.abs(found.radiance - middle)[known].mean() < 0.03


def test_backgrounds_that_do_not_agree_are_none():
    assert find_backdrop(background_views(near=True), ROWS) is None


def test_pictures_that_were_cut_out_show_no_sky():
    assert find_backdrop([dataclasses.replace(view, backdrop=False) for view in background_views()], ROWS) is None


def test_resampling_is_bilinear_and_keeps_a_smooth_sky():
    coarse = np.random.default_rng(0).normal(size=(5, columns_of(5), 3))
    np.testing.assert_allclose(resampled(coarse, 5), coarse, atol=1e-12)
    fine = resampled(coarse, 9)
    assert fine.shape == (9, columns_of(9), 3)
    # Rows of the coarse map are rows of the fine one; its columns lie a quarter of a texel to both sides.
    np.testing.assert_allclose(fine[::2, ::2], 0.75 * coarse + 0.25 * np.roll(coarse, 1, axis=1), atol=1e-12)


def test_solid_angles_fill_the_sphere():
    for rows in (3, 9, 33):
        np.testing.assert_allclose(solid_angles(rows).sum() * columns_of(rows), 1)
