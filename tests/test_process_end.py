"""A process that ends while programs still run: it waits for them, prints nothing, and has its own exit status."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import jaxdr as jd

ROOT = Path(jd.__file__).parents[1]
QUERIES = """
import sys
import jax, jax.numpy as jnp, jaxdr as jd
from jaxdr.geometry.queries import Geometry, Rays, closest_hit

def step(i, total):
    origin = jnp.stack([jnp.zeros(64), jnp.zeros(64), 3.0 + i + jnp.arange(64.0)], 1)
    rays = Rays(origin, jnp.tile(jnp.array([0.0, 0.1, -1.0]), (64, 1)), jnp.full(64, 1e6))
    return total + closest_hit(geometry, rays, "{rays}").t.sum()

ball = jd.shapes.sphere(0)
geometry = Geometry(ball.vertices, ball.faces)

@jax.jit
def run(matrix):
    return (matrix @ matrix).sum() + jax.lax.fori_loop(0, {count}, step, 0.0)

def program():  # XLA runs cheap programs at once, and counts a loop as one step: a product of matrices is not cheap
    return run(jnp.ones((300, 300)))

"""
RENDERING = """
import sys
import jax, jaxdr as jd

lamp = jd.Shape(jd.shapes.rectangle(1.0, 1.0, (0, 0, 3)), jd.TwoSided(jd.Diffuse(0.0)), jd.AreaEmitter(10.0))
camera = jd.Perspective(jd.look_at((0, -4, 1), (0, 0, 0), (0, 0, 1)), 40.0, jd.Film(32, 32))
scene = jd.Scene({{"ball": jd.Shape(jd.shapes.sphere(2)), "lamp": lamp}}, camera)
def program():
    return jd.render(scene, jax.random.key(0), {count}, jd.PathTracer(3, chunk_size=4096, rays="{rays}"))
"""
ENDS = {
    "kept": "result = program()\nprint('running' if not result.is_ready() else 'over')",
    "dropped": "program()\nprint('running')",
    "exit status": "result = program()\nprint('running' if not result.is_ready() else 'over')\nsys.exit(3)",
}


def end(code: str, how: str = "kept") -> None:
    """Run a script that ends in one of the `ENDS`, and check how it ends."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", code + ENDS[how]]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    errors = [line for line in done.stderr.splitlines() if not line.startswith("Warp CUDA warning")]
    status = 3 if how == "exit status" else 0
    assert (done.returncode, errors) == (status, [])
    assert "running" in done.stdout.splitlines(), "over before the end of the process"  # among lines of Warp's


@pytest.mark.parametrize("rays, how", [("embree", "kept"), ("warp", "dropped"), ("jax", "exit status")])
def test_while_rays_are_traced(rays, how):
    end(QUERIES.format(rays=rays, count=2_000), how)


@pytest.mark.slow
@pytest.mark.parametrize("rays", ["embree", "warp"])
def test_while_a_rendering_runs(rays):
    for number in range(20):
        end(RENDERING.format(rays=rays, count=512), list(ENDS)[number % 3])
