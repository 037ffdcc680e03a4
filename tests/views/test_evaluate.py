"""Renderings of the views of photographs, and their scores."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.views.evaluate import score_pictures
from jaxdr.views.pictures import Pixels
from jaxdr.views.rendering import Layers, layers
from tests.views.folders import SIZE, write_colmap, write_nerf

pytest.importorskip("skimage")
TRACER = jd.PathTracer(max_depth=2, boundary=None)


def ball(view, radiance=1.0, albedo=0.6):
    """A scene with a ball under an even sky."""
    shape = jd.Shape(shapes.sphere(3, radius=0.4).smooth(), jd.Diffuse(albedo))
    return jd.Scene({"ball": shape}, view.camera, jd.ConstantEnvironment(radiance))


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    return jd.load_views(write_nerf(tmp_path_factory.mktemp("nerf"), train=2, test=2))


def test_what_is_behind_is_left_out_and_alpha_is_the_silhouette(views):
    (picture, _) = jd.render_views(ball(views.views[0]), views.held_out, spp=64, integrator=TRACER)
    alpha = picture[..., 3]
    assert (picture[alpha == 0] == 0).all()
    inside = picture[alpha > 0.99]
    # A convex diffuse object under an even sky: albedo times radiance, whatever its normal.
    np.testing.assert_allclose(inside[:, :3], 0.6, atol=0.12)
    np.testing.assert_allclose(inside[:, :3].mean(), 0.6, atol=0.01)
    edge = picture[(alpha > 0.2) & (alpha < 0.8)]
    np.testing.assert_allclose(edge[:, :3] / edge[:, 3:], 0.6, atol=0.15)
    distance = np.linalg.norm(views.held_out[0].to_world[:3, 3])
    outline = views.held_out[0].focal * 0.4 / np.sqrt(distance**2 - 0.4**2)
    np.testing.assert_allclose(alpha.sum(), np.pi * outline**2, rtol=0.02)


def test_photographs_without_alpha_show_the_sky(views):
    bare = views.held_out[0].with_picture(views.held_out[0].image, None)
    (picture,) = jd.render_views(ball(bare, 0.7), [bare], spp=64, integrator=TRACER)
    (without, _) = jd.render_views(ball(bare, 0.7), views.held_out, spp=64, integrator=TRACER)
    np.testing.assert_allclose(picture[..., 3], without[..., 3])
    np.testing.assert_allclose(picture[..., :3], without[..., :3] + 0.7 * (1 - without[..., 3:]), atol=1e-4)


def test_backs_cover_what_is_behind_them():
    """One-sided sheets are black from behind, and cover the sky as their fronts do."""
    camera = jd.Perspective(jd.look_at((0, 0, -4), (0, 0, 0), (0, 1, 0)), 20.0, jd.Film(4, 4, jd.Box()))
    of = jd.Scene({"sheet": jd.Shape(shapes.rectangle(9.0, 9.0))}, camera, jd.ConstantEnvironment(0.7))
    parts = layers(of, camera, jax.random.key(0), 4, TRACER)
    np.testing.assert_allclose(parts.alpha, 1.0, rtol=1e-6)
    np.testing.assert_allclose(parts.over_black, 0.0, atol=1e-6)


def test_the_object_over_black_has_the_derivative_of_the_parts():
    parts = Layers(jnp.full((2, 2, 3), 0.5), jnp.full((2, 2), 0.25), jnp.full((2, 2, 3), 0.4))
    np.testing.assert_allclose(parts.over_black, 0.5 - 0.75 * 0.4, rtol=1e-6)
    by_alpha = jax.grad(lambda a: parts._replace(alpha=a).over_black.sum())(parts.alpha)
    np.testing.assert_allclose(by_alpha, 3 * 0.4, rtol=1e-6)


def test_a_scene_agrees_with_its_own_pictures(views):
    scene = ball(views.views[0])
    pictures = jd.render_views(scene, views.held_out, spp=64, integrator=TRACER)
    own = []
    for view, picture in zip(views.held_out, pictures, strict=True):
        alpha = picture[..., 3]
        color = picture[..., :3] / np.where(alpha > 0, alpha, 1)[..., None]
        own.append(view.with_picture(color.astype(np.float32), alpha.astype(np.float32)))
    found = jd.evaluate_views(scene, own, spp=64, integrator=TRACER)
    for score in found.scores:
        assert score.psnr > 60 and score.ssim > 0.999 and score.iou == 1
    # A sky twice as bright is told by the scale.
    brighter = jd.evaluate_views(ball(views.views[0], 2.0), own, spp=64, match_channels=True, integrator=TRACER)
    np.testing.assert_allclose(brighter.scale, 0.5, rtol=0.01)
    assert brighter.to_dict()["psnr"]["mean"] > 40


def test_photographs_with_masks_show_what_is_behind_at_the_border(tmp_path):
    """A photograph of a scene, and the mask that goes with it, agree with the scene. Over black they would not."""
    given = jd.load_views(write_colmap(tmp_path)).held_out[0]
    bare = given.with_picture(given.image, None)
    scene = ball(given, 0.7)
    (photograph,) = jd.render_views(scene, [bare], spp=64, integrator=TRACER)
    mask = (photograph[..., 3] > 0.5).astype(np.float32)
    view = dataclasses.replace(given, picture=Pixels(photograph[..., :3].astype(np.float32), mask))
    assert view.backdrop and view.masked
    (picture,) = jd.render_views(scene, [view], spp=64, integrator=TRACER)
    np.testing.assert_array_equal(picture[..., 3], mask)
    np.testing.assert_allclose(picture[..., :3], mask[..., None] * photograph[..., :3], atol=1e-6)
    np.testing.assert_allclose(view.over_black, picture[..., :3], atol=1e-6)
    (score,) = jd.evaluate_views(scene, [view], spp=64, integrator=TRACER).scores
    assert score.psnr > 60 and score.iou == 1
    soft = dataclasses.replace(view, picture=Pixels(view.image, 0.4 + 0.2 * mask))
    np.testing.assert_array_equal(soft.over_black, view.over_black)


def test_psnr_ssim_and_overlap_of_known_pictures(views):
    view = views.held_out[0]
    flat = view.with_picture(np.ones((SIZE, SIZE, 3), np.float32), None)
    grey = np.ones((SIZE, SIZE, 4), np.float32)
    (score,) = score_pictures([grey], [flat]).scores
    assert score.psnr == 100 and score.ssim == 1 and score.iou is None
    grey[..., :3] = 0.0
    (score,) = score_pictures([grey], [flat]).scores
    np.testing.assert_allclose(score.psnr, 0, atol=1e-6)
    shifted = np.zeros((SIZE, SIZE, 4), np.float32)
    shifted[..., 3] = np.roll(view.alpha, 3, axis=1)
    (score,) = score_pictures([shifted], [view]).scores
    one, other = view.alpha > 0.5, shifted[..., 3] > 0.5
    np.testing.assert_allclose(score.iou, (one & other).sum() / (one | other).sum())


def test_psnr_inside_of_a_mask_is_of_its_pixels_alone(views):
    mask = (views.held_out[0].alpha > 0.5).astype(np.float32)
    white = views.held_out[0].with_picture(np.ones((SIZE, SIZE, 3), np.float32), mask)
    (score,) = score_pictures([np.zeros((SIZE, SIZE, 4), np.float32)], [white]).scores
    np.testing.assert_allclose([score.psnr_inside, score.psnr], [0, -10 * np.log10(mask.mean())], atol=1e-5)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("what", [np.nan, np.inf])
def test_masked_pixels_do_not_count_whatever_is_in_them(views, what):
    view = views.held_out[0]
    rng = np.random.default_rng(0)
    picture = rng.random((SIZE, SIZE, 4)).astype(np.float32)
    image, alpha = view.image.copy(), view.alpha
    expected = score_pictures([picture], [view.with_picture(image, alpha)], match_channels=True)
    masked, seen = np.argwhere(alpha == 0)[0], np.argwhere(alpha > 0.9)[0]
    image[tuple(masked)] = what
    assert score_pictures([picture], [view.with_picture(image, alpha)], match_channels=True) == expected
    assert np.isfinite(view.with_picture(image, alpha).over_black).all()
    image[tuple(seen)] = np.nan
    (score,) = score_pictures([picture], [view.with_picture(image, alpha)], match_channels=True).scores
    assert np.isnan(score.psnr) and np.isnan(score.ssim) and score.iou == expected.scores[0].iou


def test_a_rendering_that_is_not_a_number_shows(views):
    """Eight bits have no NaN: it counted as black."""
    view = views.held_out[0]
    picture = np.zeros((SIZE, SIZE, 4), np.float32)
    picture[3, 4, 0] = np.nan
    (score,) = score_pictures([picture], [view]).scores
    assert np.isnan(score.psnr) and np.isnan(score.ssim)


def test_wrong_pictures_are_refused(views):
    with pytest.raises(ValueError, match="give one each"):
        score_pictures([], views.held_out)
    with pytest.raises(ValueError, match=r"r_0 has shape \[2, 2, 4\]"):
        score_pictures([np.zeros((2, 2, 4), np.float32)] * 2, views.held_out)
    with pytest.raises(ValueError, match="no view to judge by"):
        jd.evaluate_views(ball(views.views[0]), [])
    with pytest.raises(ValueError, match="spp must be"):
        jd.render_views(ball(views.views[0]), views.held_out, spp=0)
