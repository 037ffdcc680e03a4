"""The frame of the asset: upright, on the ground, to scale; cameras and light go with it."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.optimize.reconstruction.asset_frame import AssetFrame
from jaxdr.optimize.reconstruction.config import Asset, reconstruct_config
from jaxdr.optimize.reconstruction.sky import TO_WORLD, columns_of, directions
from jaxdr.optimize.reconstruction.upright import circle
from jaxdr.views.record import Views
from tests.optimize.reconstruction.test_upright import CENTRE, UP, views

POINTS = CENTRE + np.random.default_rng(0).uniform(-0.5, 0.5, (200, 3))


AROUND = views(circle(UP, CENTRE, 3.0, 9)[:4])


@pytest.mark.parametrize("asset", [Asset(), Asset(up="2,-1,0.5"), Asset(scale=0.4), Asset(height=0.25)])
def test_it_stands_upright_on_the_ground(asset):
    frame = AssetFrame.of(POINTS, AROUND, asset)
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) > 0
    np.testing.assert_allclose(frame.rotation @ UP, [0, 1, 0], atol=1e-6)
    found = frame.points(POINTS)
    low, high = found.min(0), found.max(0)
    np.testing.assert_allclose([low[1], low[0] + high[0], low[2] + high[2]], 0, atol=1e-9)
    tall = np.ptp(POINTS @ UP)
    np.testing.assert_allclose(high[1], asset.height or tall * (asset.scale or 1.0), rtol=1e-6)
    np.testing.assert_allclose(POINTS @ frame.matrix[:3, :3].T + frame.matrix[:3, 3], found)
    # Most cameras are in front.
    eyes = frame.points(np.stack([view.to_world[:3, 3] for view in AROUND]))
    assert eyes[:, 2].mean() > 1e-3 and abs(eyes[:, 0].mean()) < 0.1 * eyes[:, 2].mean()


@pytest.mark.parametrize("axis", ["x", "-y", "z"])
def test_up_may_be_an_axis(axis):
    frame = AssetFrame.of(POINTS, AROUND, Asset(up=axis))
    expected = (-1 if "-" in axis else 1) * np.eye(3)["xyz".index(axis[-1])]
    np.testing.assert_allclose(frame.rotation[1], expected, atol=1e-12)


def test_cameras_straight_above_have_no_front():
    above = views([jd.look_at(CENTRE + 3 * UP, CENTRE, (0, 0, 1))])
    frame = AssetFrame.of(np.array([CENTRE, CENTRE + UP]), above, Asset(up="2,-1,0.5"))
    np.testing.assert_allclose(frame.rotation @ UP, [0, 1, 0], atol=1e-6)
    assert np.isfinite(frame.matrix).all()


def test_cameras_see_the_same_from_their_new_places():
    frame = AssetFrame.of(POINTS, AROUND, Asset(scale=2.0))
    moved = frame.views(Views(Path(), tuple(AROUND))).views
    for one, other in zip(AROUND, moved, strict=True):
        x, y, depth = one.project(POINTS)
        np.testing.assert_allclose(other.project(frame.points(POINTS)), (x, y, 2 * depth), rtol=1e-6)


def test_the_light_comes_from_the_same_side():
    """A smooth sky, as a map of the world and as one of the frame."""
    frame = AssetFrame.of(POINTS, AROUND, Asset())

    def sky(direction):
        return 1 + 0.5 * direction @ np.array([0.3, -0.5, 0.8])[:, None] * np.array([1.0, 0.5, 0.2])

    rows = 65
    local = directions(rows).reshape(-1, 3)
    of_world = sky(local @ TO_WORLD[:3, :3].T).reshape(rows, columns_of(rows), 3)
    expected = sky(local @ frame.rotation).reshape(of_world.shape)
    np.testing.assert_allclose(frame.light(of_world), expected, atol=2e-3)
    towards = np.random.default_rng(1).normal(size=(50, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    maps = jd.EnvironmentMap(of_world, TO_WORLD), jd.EnvironmentMap(frame.light(of_world))
    here, there = (
        np.asarray(light.eval(jnp.asarray(way, jnp.float32)))
        for light, way in zip(maps, (towards, towards @ frame.rotation.T), strict=True)
    )
    np.testing.assert_allclose(there, here, atol=0.01)


@pytest.mark.parametrize(
    "asset, message",
    [
        ({"up": "w"}, "asset.up: must be"),
        ({"up": "0,0,0"}, "asset.up: must be"),
        ({"up": "1,2"}, "asset.up: must be"),
        ({"up": "nan,0,1"}, "asset.up: must be"),
        ({"scale": 0.0}, "asset.scale: must be positive"),
        ({"scale": 1.0, "height": 1.0}, "asset.height: can't be given with scale"),
    ],
)
def test_bad_frames_are_told(asset, message):
    with pytest.raises(ValueError, match=message.replace(".", r"\.")):
        reconstruct_config({}, "settings.toml", "photos", "out", asset=asset)


def test_options_go_before_the_table():
    made = reconstruct_config({"asset": {"up": "z", "scale": 2.0}}, "a.toml", "photos", "out", asset={"up": "-y"})
    assert made.asset == Asset(up="-y", scale=2.0)
