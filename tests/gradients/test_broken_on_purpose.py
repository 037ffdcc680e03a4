"""The checks of this folder must fail when the derivative is wrong: break it on purpose, expect them to notice."""

import jax.numpy as jnp
import pytest

import jaxdr as jd
from jaxdr.geometry.queries import api
from tests.gradients.floor_point import CLOSED, HALF_PLANE, SHEET, arrowhead, check_derivatives, sheet

# As in the paper: a path counts on the visible side of a silhouette, and nobody asks whether the silhouette is hidden.
NO_RAY = jd.KernelDensity(0.02, both_sides=False, visibility_ray=False)
NEITHER = jd.KernelDensity(0.02, both_sides=False, visibility_ray=False, concave_edges=True)


def test_no_boundary_term():
    """Without it the radiance does not depend on the blocker at all."""
    with pytest.raises(AssertionError, match="blocker"):
        check_derivatives(sheet(HALF_PLANE, 0.1), None)


@pytest.mark.slow
def test_hidden_silhouettes_counted():
    """An edge just inside the shadow of another is a silhouette as well, but no boundary."""
    blocker = arrowhead(concave=0.02, hidden=0.02)
    check_derivatives(blocker, CLOSED)
    with pytest.raises(AssertionError, match="blocker"):
        check_derivatives(blocker, NO_RAY)


@pytest.mark.slow
def test_concave_edges_counted():
    """So is a concave edge, by the paper's Eq. 18 alone. Here it is the only one of them within reach of the kernel."""
    blocker = arrowhead(concave=0.02, hidden=0.1)
    check_derivatives(blocker, NO_RAY)
    with pytest.raises(AssertionError, match="blocker"):
        check_derivatives(blocker, NEITHER)


def test_stale_geometry(monkeypatch):
    """Queries that still see the blocker where it was a step ago."""
    fresh = api._asked

    def stale(query, fixed, rows=(), **options):
        if not rows:  # not rays: the rays that ask what is visible are stale enough
            return fresh(query, fixed, rows, **options)
        geometry, *others = fixed
        blocker = (geometry.vertices[:, 2] > 0.3) & (geometry.vertices[:, 2] < 0.9)
        moved = geometry.vertices + jnp.where(blocker[:, None], jnp.asarray([0.08, 0.0, 0.0]), 0.0)
        return fresh(query, (geometry._replace(vertices=moved), *others), rows, **options)

    monkeypatch.setattr(api, "_asked", stale)
    with pytest.raises(AssertionError, match="is off"):
        check_derivatives(sheet(HALF_PLANE, 0.1), SHEET, spp=127)  # a number of its own: traced afresh
