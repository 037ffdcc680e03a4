"""The change of a path's derivative by the material form of first hits; see `near_field`."""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from jaxdr.geometry.vector import dot, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, material_point
from jaxdr.transport.near_field import footprint
from jaxdr.transport.path import PathRecord
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.transfer import transfer_to


def near_field_term(packed: PackedScene, primary: PrimarySamples, record: PathRecord) -> Float[Array, "N 3"]:
    """Replaces the fixed form by the material form for the share s of first hits' light; zero in value.

    `record` has first hits on fixed rays. Let f and f' be the light that they scatter in the fixed and in the material
    form; both are equal in value. Let w be the importance of the material form. The term is s w f' - s f. To first
    order this is f with its point moved by s times the difference of the forms, and f times the changes of s and w. The
    light that arrives is the same in both forms.
    """
    assert primary.near is not None and record.near is not None  # set if first hits have two forms
    assert record.direct is not None and record.scattered is not None
    still, near, light = stop_gradient(packed), primary.near, record.near
    point = stop_gradient(primary.first)

    def apart(material, fixed):
        return (material - stop_gradient(material)) - (fixed - stop_gradient(fixed))

    position = apart(near.point.position, primary.first.position)
    shading_normal = apart(near.point.shading_normal, primary.first.shading_normal)
    on_face = None if point.on_face is None else apart(near.point.on_face, primary.first.on_face)
    wi, importance = apart(near.wi, -primary.direction), near.importance - stop_gradient(near.importance)
    view = stop_gradient(near.camera)

    def part(face, barycentric, carried, share):
        there = share > 0
        target = material_point(still, face, barycentric, there)
        moved = SurfacePoint(
            *point[:3],
            position=point.position + scale(position, share),
            normal=point.normal,
            shading_normal=point.shading_normal + scale(shading_normal, share),
            area=point.area,
            scale=point.scale,
            on_face=None if on_face is None else point.on_face + scale(on_face, share),
        )
        scatterer = Scatterer(still, moved, stop_gradient(-primary.direction) + scale(wi, share))
        value = transfer_to(scatterer, target, ~there, jnp.zeros_like(wi)).value
        lit = (stop_gradient(value) != 0) & there[:, None]  # the derivative by motion is zero where the value is
        arriving = safe_divide(carried, stop_gradient(value), lit, 0.0)
        offset = target.position - (point.position + position)
        changed = footprint(view, point.position + position, point.normal).share(
            jnp.where(there, dot(offset, offset), 1.0)
        )
        changed = jnp.where(there, changed - stop_gradient(changed), 0.0) + share * importance
        return arriving * (value - stop_gradient(value)) + scale(carried, changed)

    one, two = (jax.tree.map(lambda x: x[0], s) for s in (record.direct, record.scattered))
    both = jax.tree.map(
        lambda *x: jnp.stack(x),
        (one.target_face, one.target_barycentric, light.light, light.light_share),
        (two.target_face, two.target_barycentric, light.beyond, light.beyond_share),
    )
    return jax.vmap(part)(*both).sum(0)
