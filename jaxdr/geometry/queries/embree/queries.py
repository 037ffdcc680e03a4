"""Nearest hits and occlusion by Embree on the CPU, with the interface of `warp.queries`.

All other queries, and these two on other devices, are Warp's own.
"""

import jax
import jax.numpy as jnp

from jaxdr.geometry.queries.embree import native
from jaxdr.geometry.queries.warp import queries as warp_queries
from jaxdr.geometry.queries.warp.queries import (  # noqa: F401
    closest_silhouettes,
    draw_edges,
    edge_candidates,
    edge_tree,
    face_intersections,
    point_candidates,
    projections,
    sector_crossings,
    silhouettes,
)


def _on_cpu(native_query, warp_query, *arguments):
    """The query by Embree on CPUs, by Warp elsewhere."""
    if jax.default_backend() == "cpu":  # there is nothing else, and one branch less to trace
        return native_query(*arguments)
    return jax.lax.platform_dependent(*arguments, cpu=native_query, default=warp_query)


def closest_hit(geometry, rays):
    """(face, t, barycentric): the nearest face in front of each ray, -1 and a huge t on a miss."""
    n = rays.reach.shape[0]
    kinds = [jax.ShapeDtypeStruct(s, k) for s, k in (((n,), jnp.int32), ((n,), jnp.float32), ((n, 3), jnp.float32))]
    return _on_cpu(
        lambda geometry, rays: tuple(native.call("jaxdr_closest_hit", kinds, *geometry, *rays)),
        lambda geometry, rays: tuple(warp_queries.closest_hit(geometry, rays)),
        geometry,
        rays,
    )


def occluded(geometry, rays):
    """Whether anything lies on the ray before its reach."""
    kind = jax.ShapeDtypeStruct(rays.reach.shape, jnp.bool_)
    return _on_cpu(
        lambda geometry, rays: native.call("jaxdr_occluded", kind, *geometry, *rays),
        warp_queries.occluded,
        geometry,
        rays,
    )
