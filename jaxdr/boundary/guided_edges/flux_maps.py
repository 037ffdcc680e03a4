"""Photon and importon maps for guides: how much light surfaces scatter, and how much of it the film would see.

They are tables on a regular grid over the scene, read without interpolation. They only steer samples, so they may be
coarse (Yan et al. 2022, after Eq. 11).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.geometry.vector import dot
from jaxdr.scene.color import magnitude
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import sample_emitter
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples
from jaxdr.transport.sampler import lattice, uniform
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.subpaths import Subpath, camera_start, light_start, trace_on

SIDE = 24  # cells along each side of the scene
PHOTONS = 1 << 14
FLOOR = 0.02  # smallest value of a cell, relative to the mean of the cells that are not zero


class FluxMaps(NamedTuple):
    """Two maps of C cells.

    `radiance`: magnitude that the surface in a cell scatters. `importance`: that of the surface in a cell for the film,
    after one bounce or more towards the camera; square pixels per area and steradian.
    """

    lower: Float[Array, "3"]
    cell: Float[Array, "3"]
    radiance: Float[Array, " C"]
    importance: Float[Array, " C"]

    def radiance_at(self, position: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """`radiance` of the cells of points."""
        return self.radiance[_cell(self.lower, self.cell, position)]

    def importance_at(self, position: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """`importance` of the cells of points."""
        return self.importance[_cell(self.lower, self.cell, position)]


def _cell(lower, cell, position):
    x, y, z = jnp.clip(jnp.floor((position - lower) / cell).astype(jnp.int32), 0, SIDE - 1).T
    return (x * SIDE + y) * SIDE + z


def flux_maps(packed: PackedScene, key: PRNGKeyArray, settings: PathSettings) -> FluxMaps:
    """Maps for paths of `max_depth` segments, three or more."""
    packed = jax.tree.map(stop_gradient, packed)
    dtype, bounces = packed.vertices.dtype, settings.max_depth - 2
    lower, upper = packed.vertices.min(0), packed.vertices.max(0)
    cell = (upper - lower) / SIDE
    cell = jnp.where(cell > 0, cell, cell.max())
    area = jnp.sort(cell)[1:].prod()
    key_emitter, key_light, key_first, key_camera = jax.random.split(key, 4)

    u = lattice(key_emitter, 1, jnp.arange(PHOTONS), 4, dtype)
    light = light_start(packed, sample_emitter(packed, u[:, :2]), u[:, 2:], 1, settings.rays)
    light = trace_on(packed, light, uniform(key_light, (bounces - 1, PHOTONS, 2), dtype), True, 1, settings.rays)
    photons = light.vertices(bounces)
    radiance = _deposited(packed, photons, lower, cell) / (PHOTONS * area)

    _, _, width, height = packed.camera.film.window
    spp = max(1, PHOTONS // (width * height))
    primary = primary_samples(packed, jnp.arange(spp), key_first, settings.rays, Form.FIXED)
    count = primary.u.shape[0]
    camera = camera_start(packed, primary)
    camera = trace_on(packed, camera, uniform(key_camera, (bounces, count, 2), dtype), False, 1, settings.rays)
    importons = jax.tree.map(lambda a: a[1:].reshape(-1, *a.shape[2:]), camera)
    importance = _deposited(packed, importons, lower, cell) * (width * height / (count * area))
    return FluxMaps(lower, cell, _floored(radiance), _floored(importance))


def _deposited(packed: PackedScene, vertex: Subpath, lower, cell) -> Float[Array, " C"]:
    """Throughput times the BSDF along the surface's normal, summed over the vertices in every cell."""
    point = vertex.point
    side = jnp.where(dot(point.normal, vertex.back) >= 0, 1.0, -1.0)[:, None]
    value = magnitude(vertex.throughput * Scatterer(packed, point, side * point.normal).eval(vertex.back))
    value = jnp.where(point.valid, value, 0.0)
    return jnp.zeros(SIDE**3, value.dtype).at[_cell(lower, cell, point.position)].add(value)


def _floored(table):
    count = (table > 0).sum()
    return jnp.maximum(table, FLOOR * table.sum() / jnp.maximum(count, 1))
