"""Light from close by under a box filter: the material form with its flux through pixel borders, or rays held fixed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.render import derivative_terms

FILM = 6


def fold() -> jd.Scene:
    """Two panels that meet in a concave fold, lit from the side, before a camera whose pixels are large."""
    points = np.array(
        [[-1.0, 0.0, 0.0], [0.0, 0.1, -0.4], [1.0, 0.0, 0.3], [-1.0, 1.2, 0.1], [0.1, 1.0, -0.5], [1.0, 1.1, 0.2]]
    )
    panels = jd.Mesh(points, [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    corner, a, b = np.array([-0.6, -1.8, 2.0]), np.array([0.0, 0.9, -0.2]), np.array([1.2, 0.0, 0.0])
    lamp = jd.Mesh([corner, corner + a, corner + a + b, corner + b], [[0, 1, 2], [0, 2, 3]])
    return jd.Scene(
        {
            "fold": jd.Shape(panels, jd.TwoSided(jd.Diffuse([0.9, 0.7, 0.5]))),
            "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
        },
        jd.Perspective(jd.look_at([0.1, 0.4, 3.0], [0.0, 0.55, 0.0], [0, 1, 0]), 14.0, jd.Film(FILM, FILM, jd.Box())),
    )


def derivatives(tiles: bool, monkeypatch, keys: int, spp: int):
    """By term, [keys, H, W, 3]: the derivative image as one corner of the fold is moved and turned about the others."""
    monkeypatch.setattr(jd.Box, "tiles", tiles)
    scene = fold()
    vertices = scene.parameters()["fold.vertices"]
    motion = jnp.asarray(
        [[0.3, 0.2, 0.1], [0.2, -0.1, 0.4], [0.2, 0.1, 0.0], [0.1, 0.3, 0.2], [0.4, 0.1, 0.3], [0.1, 0.2, 0.1]]
    )
    integrator = jd.PathTracer(max_depth=3, boundary=jd.LineSampling())

    @jax.jit
    def run(key):
        def terms(v):
            return derivative_terms(scene.replace({"fold.vertices": v}), key, spp, integrator)

        return jax.jvp(terms, (vertices,), (motion,))[1]

    rows = [jax.device_get(run(key)) for key in jax.random.split(jax.random.key(3), keys)]
    return {name: np.stack([row[name] for row in rows]).astype(float).mean(-1) for name in rows[0]}


@pytest.mark.slow
def test_flux_through_pixel_borders(monkeypatch):
    """The sum is the same in both forms, and would not be without the flux; the noise of the material form is less."""
    near = derivatives(True, monkeypatch, 24, 256)
    fixed = derivatives(False, monkeypatch, 24, 256)
    flux = near["pixel_borders"]
    assert "pixel_borders" not in fixed
    one, two = sum(near.values()), sum(fixed.values())
    error = np.sqrt((one.var(0, ddof=1) + two.var(0, ddof=1)) / len(one))
    off = (one.mean(0) - two.mean(0)) / error
    assert np.abs(off).max() < 4, off
    assert np.abs(off - flux.mean(0) / error).max() > 5  # it would be noticed if it were missing
    assert one.var(0).mean() < 0.01 * two.var(0).mean()
