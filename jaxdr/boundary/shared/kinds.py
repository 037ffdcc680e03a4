"""Kinds of boundary segments: which light comes along a segment, and over which lobes the camera receives it.

A boundary integral is a sum over kinds. A `Context` names those that a term is asked for. A segment's light is what is
behind the silhouette: what an area emitter emits, what the environment emits, or what a surface scatters. The lobe is
that of the vertex from which the silhouette is seen, `reflected` if the camera receives it over a glossy vertex.
"""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxdr.scene.bsdf.base import has_lobe
from jaxdr.scene.packed import PackedScene

LIGHTS = ("emitters", "environment", "scattered")
LOBES = ("diffuse", "glossy", "reflected")
KINDS = tuple(f"{light}_{lobe}" for light in LIGHTS for lobe in LOBES)


def asked_for(kinds: Iterable[str], light: str) -> bool:
    """Whether any of the kinds has this light."""
    return any(kind.startswith(light) for kind in kinds)


def present(packed: PackedScene, max_depth: int, kinds: Iterable[str]) -> tuple[str, ...]:
    """Those of the kinds that a scene may have, by its structure."""
    glossy = [has_lobe(group.bsdf) for group in packed.bsdfs]
    there = {
        "emitters": packed.has_area_emitters and max_depth > 1,
        "environment": packed.environment is not None and max_depth > 1,
        "scattered": max_depth > 2,
        "diffuse": not all(glossy),
        "glossy": any(glossy),
        "reflected": any(glossy) and max_depth > 2,
    }
    found = [kind for kind in kinds if all(there[part] for part in kind.split("_"))]
    # The last vertex of a path gathers no scattered light.
    return tuple(kind for kind in found if kind != "scattered_reflected" or max_depth > 3)


def glossy_at(packed: PackedScene, face: Int[Array, "*n"]) -> Bool[Array, "*n"]:
    """Whether faces have a glossy BSDF."""
    shapes = packed.glossy
    return jnp.zeros(face.shape, bool) if shapes is None else shapes[packed.face_shape[face]]


def lobes_along(here: Bool[Array, "B n"], before: Bool[Array, "B n"]) -> Int[Array, "B n"]:
    """Numbers among `LOBES`: of vertices that are glossy `here`, and that a glossy vertex comes `before`."""
    return jnp.where(before, 2, here.astype(jnp.int32))


def any_above(flags: Bool[Array, "B n"]) -> Bool[Array, "B n"]:
    """Whether any earlier row has the flag."""
    found = jax.lax.cummax(flags.astype(jnp.int32), axis=0) > 0
    return jnp.concatenate([jnp.zeros_like(found[:1]), found[:-1]])


def of_kind(kinds: Iterable[str], light: str, lobe: Int[Array, "*n"]) -> Bool[Array, "*n"] | bool:
    """Whether segments with this light and lobes of these numbers count; a plain bool if all lobes are alike."""
    flags = [f"{light}_{name}" in kinds for name in LOBES]
    if len(set(flags)) == 1:
        return flags[0]
    return jnp.stack([lobe == number for number, flag in enumerate(flags) if flag]).any(0)
