"""The near field's derivative against the formula it is written after, both forms evaluated as they are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.lax import stop_gradient

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, sphere
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point
from jaxdr.transport.near_paths import near_field_term
from jaxdr.transport.path import trace_paths, transfer_to
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples
from jaxdr.transport.shading import Scatterer

KEY = jax.random.key(7)
SETTINGS = PathSettings(4, True, "auto")


def scene() -> jd.Scene:
    """A lamp that touches the floor, and a glossy ball with interpolated normals that lies on it."""
    lamp = jd.Mesh([[1.0, -1, 0], [1.0, 1, 0], [1.2, 1, 1.5], [1.2, -1, 1.5]], [[0, 2, 1], [0, 3, 2]])
    ball = sphere(3, 0.5, (0.0, 0.0, 0.5))
    shapes = {
        "floor": jd.Shape(rectangle(6.0, 6.0), jd.Diffuse([0.7, 0.5, 0.3])),
        "ball": jd.Shape(ball.smooth(), jd.TwoSided(jd.RoughConductor(0.3))),
        "lamp": jd.Shape(lamp, jd.TwoSided(jd.Diffuse(0.5)), jd.AreaEmitter(6.0)),
    }
    camera = jd.Perspective(jd.look_at([-2, -3, 2.5], [0.3, 0, 0.3], [0, 0, 1]), 40.0, jd.Film(12, 8, jd.Gaussian()))
    return jd.Scene(shapes, camera)


def literal(packed, primary, record):
    """The sum over the light sample and what the BSDF sample found of s_m w f_m - s_f f_f, and the part of f alone."""
    near, still = primary.near, stop_gradient
    total = scattered = 0.0
    for segments, carried, share in (
        (record.direct, record.near.light, record.near.light_share),
        (record.scattered, record.near.beyond, record.near.beyond_share),
    ):
        far = share <= 0
        target = material_point(packed, segments.target_face[0], segments.target_barycentric[0], ~far)

        def form(point, wi, far=far, target=target):
            value = transfer_to(Scatterer(packed, point, wi), target, far, jnp.zeros_like(wi)).value
            return value, near.share(point, target.position, far)[:, None]

        value_m, share_m = form(near.point, near.wi)
        value_f, share_f = form(primary.first, -primary.direction)
        lit = (value_f != 0) & (carried != 0)
        arriving = jnp.where(lit, carried, 0.0) / still(jnp.where(lit, value_f, 1.0))
        total += still(arriving) * (share_m * near.importance[:, None] * value_m - share_f * value_f)
        scattered += still(arriving * share_f) * (value_m - value_f)
    return total, scattered


@pytest.mark.parametrize("name", ["ball.vertices", "floor.vertices", "lamp.vertices", "camera.to_world"])
def test_it_is_the_difference_of_two_forms(name):
    with jax.enable_x64(True):
        of = jax.tree.map(lambda x: x.astype(float) if jnp.issubdtype(x.dtype, jnp.floating) else x, scene())
        at = of.parameters()[name]
        motion = 0.1 * jax.random.normal(KEY, at.shape, float)
        if name == "camera.to_world":
            motion = motion.at[:3, :3].set(0.0).at[3].set(0.0)

        def traced(x):
            packed = pack(of.replace({name: x}))
            primary = primary_samples(packed, jnp.arange(8), KEY, "auto", Form.NEAR)
            arguments = primary.first, primary.direction, primary.u, jax.random.fold_in(KEY, 1), SETTINGS
            return packed, primary, trace_paths(packed, *arguments, primary.near)

        @jax.jit
        def both(x):
            return near_field_term(*traced(x)), *literal(*traced(x))

        values, (term, formula, scattered) = jax.jvp(both, (at,), (motion,))
        assert np.all(values[0] == 0)
        scale = np.sqrt(np.mean(formula**2))
        assert scale > 1e-3 and np.sqrt(np.mean(scattered**2)) > 1e-4
        np.testing.assert_allclose(term, formula, rtol=1e-7, atol=1e-7 * scale)
