"""A spot with an image: where texels are lit, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from tests.scene.bsdf.checks import check_derivatives, random_directions

IMAGE = np.random.default_rng(0).uniform(0.1, 1.0, (4, 5, 3))


def spot(**changed):
    values = {"position": (0, 0, 0), "direction": (0, 0, 2.0), "texture": IMAGE, "up": (0, 1.0, 0.3), "intensity": 2.0}
    return jd.TexturedSpotLight(**values | {"cutoff_angle": 45.0, "beam_width": 44.0} | changed)


def test_texels_are_where_the_frame_says():
    """Columns along x, rows along y of the frame, across the square around the cone's circle."""
    row, column = np.mgrid[1:3, 1:4]
    across, down = (2 * (column.ravel() + 0.5) / 5 - 1), (2 * (row.ravel() + 0.5) / 4 - 1)
    direction = np.column_stack([across, down, np.ones(6)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    found = spot().intensity_in(jnp.asarray(direction, float))
    np.testing.assert_allclose(found, 2 * IMAGE[1:3, 1:4].reshape(-1, 3), rtol=1e-5)
    assert np.all(spot().intensity_in(jnp.asarray([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])) == 0)


def test_derivatives():
    """By every field and by the direction, against central differences in float64."""
    with jax.enable_x64(True):
        light = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), spot(beam_width=10.0))
        direction = jnp.asarray(np.asarray(random_directions(30, 1, 0.8)), jnp.float64)
        moves = check_derivatives(lambda of, w: of.intensity_in(w), (light, direction), step=1e-7, rtol=1e-3)
        assert moves.count(False) == 1  # the position


def test_what_is_refused():
    with pytest.raises(ValueError, match="texture must be an RGB image"):
        spot(texture=np.ones((4, 5)))
    with pytest.raises(ValueError, match="cutoff_angle must be below 90"):
        spot(cutoff_angle=90.0)
    with pytest.raises(ValueError, match="up must not be along the direction"):
        spot(up=(0, 0, -1.0))
