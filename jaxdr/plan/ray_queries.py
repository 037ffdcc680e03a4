"""Whether trying every face for every ray is faster than a bounding volume hierarchy."""

import statistics
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdr.compilation import jit
from jaxdr.geometry import queries
from jaxdr.scene.packed import pack
from jaxdr.scene.scene import Scene

RAYS = 4096
TURNS = 7


class RayChoice(NamedTuple):
    """Seconds for the same rays, by implementation; empty where nothing was measured."""

    seconds: dict[str, float]

    @property
    def brute_force(self) -> bool:
        """Whether brute force was faster."""
        return bool(self.seconds) and self.seconds["jax"] < self.seconds["auto"]

    def line(self, faces: int) -> str:
        """One line that says why."""
        if not self.seconds:
            return f"rays: a bounding volume hierarchy; {faces:,} faces are too many to try all"
        times = ", ".join(f"{name} {1e3 * taken:.2g} ms" for name, taken in self.seconds.items())
        first = "brute force" if self.brute_force else "a bounding volume hierarchy"
        return f"rays: {first} is faster for {faces:,} faces ({RAYS:,} rays: {times})"


def time_rays(scene: Scene) -> RayChoice:
    """Time the nearest hits of rays through the scene, with the hierarchy ("auto") and without it ("jax"), in turns."""
    packed = pack(scene)
    low, high = packed.vertices.min(0), packed.vertices.max(0)
    key_start, key_towards = jax.random.split(jax.random.key(0))
    start = low + (high - low) * jax.random.uniform(key_start, (RAYS, 3))
    towards = jax.random.normal(key_towards, (RAYS, 3))
    rays = queries.Rays(start, towards, jnp.full(RAYS, 1e30))
    programs, seconds = {}, {}
    for name in ("auto", "jax"):
        programs[name] = jit(lambda v, name=name: queries.closest_hit(packed.geometry._replace(vertices=v), rays, name))
        jax.block_until_ready(programs[name](packed.vertices))
        seconds[name] = []
    for turn in range(TURNS):
        moved = jax.block_until_ready(packed.vertices * (1 + 1e-6 * (turn + 1)))  # hierarchies are kept by content
        for name, program in programs.items():
            begin = time.perf_counter()
            jax.block_until_ready(program(moved))
            seconds[name].append(time.perf_counter() - begin)
    return RayChoice({name: statistics.median(some) for name, some in seconds.items()})
