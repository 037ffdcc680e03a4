"""A library prints nothing: neither on a rendering with every kind of query, nor where Warp starts or loads kernels."""

import subprocess
import sys

PROGRAM = """
import jax, numpy as np
import jaxdr as jd
pose = jd.look_at((0, -4, 1), (0, 0, 0), (0, 0, 1))
shapes = {"box": jd.Shape(jd.shapes.box())}
scene = jd.Scene(shapes, jd.Perspective(pose, 40.0, jd.Film(4, 4)), jd.ConstantEnvironment(1.0))
for rays in ("auto", "warp"):
    jd.render(scene, jax.random.key(0), 1, jd.PathTracer(max_depth=2, rays=rays)).block_until_ready()
jd.chamfer(jd.shapes.sphere(0), jd.shapes.sphere(0))
"""


def ran(program: str) -> subprocess.CompletedProcess:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done


def test_nothing_is_printed():
    done = ran(PROGRAM)
    assert (done.stdout, done.stderr) == ("", "")


def test_the_level_of_others_is_left_alone():
    """Who chose a level of Warp's messages sees them, and the default is there again for others."""
    done = ran("import warp; warp.config.log_level = warp.LOG_DEBUG" + PROGRAM)
    assert "initialized" in done.stdout
    done = ran(PROGRAM + "import warp; print(warp.config.log_level == warp.LOG_INFO)")
    assert done.stdout == "True\n"


def test_what_others_write_to_the_descriptor_is_kept():
    program = """
import os
from jaxdr import quiet_warp
with quiet_warp._without(b"bad"):
    os.write(2, b"good\\nbad line\\nlast")
"""
    assert ran(program).stderr == "good\nlast"


def test_an_error_is_not_lost():
    program = """
import os
from jaxdr import quiet_warp
try:
    with quiet_warp._without(b"bad"):
        os.write(2, b"bad line\\ncause\\n")
        raise ValueError
except ValueError:
    os.write(2, b"after")
"""
    assert ran(program).stderr == "cause\nafter"


def test_without_standard_error_it_starts():
    program = "import os; os.close(2)\nfrom jaxdr.quiet_warp import start_warp; start_warp(); print(1)"
    assert ran(program).stdout == "1\n"
