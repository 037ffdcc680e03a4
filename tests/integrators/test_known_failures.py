"""Estimators that fail by nature: one warning at the caller's line, by the rules that plans and defaults go by."""

import inspect
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.shared import traits as of_scenes
from jaxdr.boundary.shared.traits import known_failure, traits
from jaxdr.geometry.shapes import box, rectangle, sphere
from jaxdr.integrators.choice import choose
from jaxdr.integrators.known_failures import turning_away
from jaxdr.moving import Moving, moving_in
from jaxdr.plan.candidates import candidates
from jaxdr.plan.static_look import static_look

CAMERA = jd.Perspective(jd.look_at([0, -5, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(4, 4))
ROOT = Path(__file__).parents[2]
ROUND = sphere(1, radius=0.3, center=(0.0, 0.0, 3.0))
RIGHT = jd.LineSampling()


def scene(lamp=None):
    shapes = {
        "box": jd.Shape(box()),
        "floor": jd.Shape(rectangle(8.0, 8.0, (0.0, 0.0, -1.5))),
        "lamp": jd.Shape(lamp or rectangle(1.0, 1.0, (0.0, 0.0, 3.0)), jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
    }
    return jd.Scene(shapes, CAMERA)


def derivative(of, boundary, name="box.vertices", depth=2):
    """A function of one parameter whose gradient is by an estimator."""

    def loss(value):
        return jd.render(of.replace({name: value}), jax.random.key(0), 1, jd.PathTracer(depth, boundary)).sum()

    return jax.grad(loss), of.parameters()[name]


def line_of_render() -> int:
    lines, first = inspect.getsourcelines(derivative)
    return first + next(i for i, line in enumerate(lines) if "jd.render(" in line)


def warned(of, boundary, **options) -> list:
    """Tracing alone: nothing is compiled."""
    function, value = derivative(of, boundary, **options)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        jax.eval_shape(function, value)
    return [w for w in caught if issubclass(w.category, jd.EstimatorWarning)]


FAILURES = {
    "kernel, round lamp": (lambda: scene(ROUND), jd.KernelDensity(), "more than 16 faces"),
    "Eq. 57 on the sphere": (scene, jd.RednerWAS(), "exponential"),
    "Eq. 57": (scene, jd.WarpedArea("exponential"), "exponential"),
    "few points": (scene, jd.WarpedArea(samples=5), "with 5 auxiliary points"),
    "solids' outlines": (scene, jd.RednerWAS("path_space", normal_edges=False), "normal_edges=False"),
    "small lights": (scene, jd.RednerWAS("path_space"), "under small lights"),
}


@pytest.mark.parametrize("name", FAILURES)
def test_failures_have_a_reason_and_a_remedy(name):
    made, boundary, why = FAILURES[name]
    reason = known_failure(boundary, traits(made()))
    assert reason is not None and why in reason and "take " in reason
    assert known_failure(RIGHT, traits(made())) is None and known_failure(None, traits(made())) is None


@pytest.mark.parametrize("boundary", [jd.KernelDensity(), jd.GuidedEdges(), jd.WarpedArea(), RIGHT], ids=repr)
def test_nothing_is_said_of_what_is_right(boundary):
    assert known_failure(boundary, traits(scene())) is None


def test_fine_meshes(monkeypatch):
    assert known_failure(jd.KernelDensity(), traits(scene())) is None
    monkeypatch.setattr(of_scenes, "FINE", 12)
    for boundary in (jd.KernelDensity(), jd.GuidedEdges(), jd.MarkovChains()):
        assert "such as box" in (known_failure(boundary, traits(scene())) or "")
    assert known_failure(RIGHT, traits(scene())) is None


def test_one_warning_at_the_callers_line():
    (found,) = warned(scene(ROUND), jd.KernelDensity())
    assert (found.filename, found.lineno) == (__file__, line_of_render())
    assert str(found.message).startswith("jaxdr: KernelDensity fails by nature here: ")


TRACE_AGAIN = """
import jax, jaxdr as jd
from tests.integrators.test_known_failures import RIGHT, ROUND, derivative, scene
from jaxdr.geometry.shapes import sphere

function, value = derivative(scene(), RIGHT)
jax.eval_shape(jax.jit(function), value)  # what is imported on first use makes Python forget what it has shown
for lamp in (ROUND, ROUND, sphere(2, radius=0.3, center=(0.0, 0.0, 3.0))):
    function, value = derivative(scene(lamp), jd.KernelDensity())
    jax.eval_shape(jax.jit(function), value)
"""


def test_tracing_again_is_no_news():
    """By Python's default filter: once a line and text. In a process of its own: beartype makes Python forget, too."""
    run = subprocess.run(
        [sys.executable, "-W", "default", "-c", TRACE_AGAIN], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert run.stderr.count("EstimatorWarning: ") == 1


@pytest.mark.slow
def test_compiled_calls_warn_once():
    function, value = derivative(scene(ROUND), jd.KernelDensity())
    compiled = jax.jit(function)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for i in range(3):
            compiled(value + 0.01 * i).block_until_ready()
    (found,) = (w for w in caught if issubclass(w.category, jd.EstimatorWarning))
    assert (found.filename, found.lineno) == (__file__, line_of_render())


def test_where_there_is_no_boundary_term_nothing_is_said():
    of = scene(ROUND)
    assert not warned(of, jd.KernelDensity(), name="floor.bsdf.reflectance")
    assert not warned(of, jd.KernelDensity(), depth=1)
    assert not warned(of, None)
    with warnings.catch_warnings():
        warnings.simplefilter("error", jd.EstimatorWarning)
        jax.eval_shape(lambda v: jd.render(of.replace({"box.vertices": v}), jax.random.key(0), 1), jnp.zeros((8, 3)))


@pytest.mark.parametrize("made", [scene, lambda: scene(ROUND)])
def test_plans_and_defaults_go_by_the_same_rules(made):
    of = made()
    found = candidates(static_look(of, Moving((True, False, False), False)), 2)
    assert not [name for name, boundary in found.tried.items() if known_failure(boundary, traits(of))]
    fails = known_failure(jd.KernelDensity(), traits(of))
    assert found.left_out.get("KernelDensity") == fails
    assert known_failure(choose(of).estimator, traits(of)) is None


HEIGHTS = jd.Bitmap(np.random.default_rng(0).uniform(size=(4, 4)))
BUMPS = jd.BumpMap(HEIGHTS, jd.Diffuse(0.5), 0.2)
MAPS = {
    "bump map": BUMPS,
    "normal map": jd.NormalMap(jd.Bitmap(np.full((2, 2, 3), (0.7, 0.5, 0.8))), jd.Diffuse()),
    "two-sided": jd.TwoSided(BUMPS),
    "in a blend": jd.Blend(0.3, jd.Diffuse(), BUMPS),
    "in a mask": jd.Mask(0.5, BUMPS),
}
MOVES = {  # what is differentiated, to which depth: whether the curve of flipped normals on a bumpy floor moves
    ("floor.vertices", 2): True,
    ("camera.to_world", 2): True,
    ("camera.fov", 2): True,
    ("floor.bsdf.scale", 2): True,
    ("floor.bsdf.height.pixels", 2): True,
    ("box.vertices", 3): True,
    ("box.vertices", 2): False,
    ("floor.bsdf.bsdf.reflectance", 3): False,
    ("lamp.emitter.radiance", 3): False,
    ("floor.vertices", 1): False,
}


def with_floor(bsdf):
    of = scene()
    return jd.Scene(of.shapes | {"floor": jd.Shape(of.shapes["floor"].mesh, bsdf)}, CAMERA)


def flipped(of, name, depth):
    """The shape whose flipped normals are told of if the parameter `name` alone is differentiated."""
    parameter = of.parameters()[name]
    active = jax.tree.map(lambda leaf: leaf is parameter, of)
    assert sum(jax.tree.leaves(active)) == 1
    return turning_away(active, moving_in(of, active), depth)


@pytest.mark.parametrize(("name", "depth"), MOVES)
def test_jumps_of_flipped_normals_are_told(name, depth):
    assert flipped(with_floor(BUMPS), name, depth) == ("floor" if MOVES[name, depth] else None)


@pytest.mark.parametrize("kind", MAPS)
def test_every_map_that_turns_normals_is_found(kind):
    assert flipped(with_floor(MAPS[kind]), "camera.to_world", 2) == "floor"
    assert flipped(scene(), "camera.to_world", 3) is None


def test_a_warning_of_flipped_normals():
    of = with_floor(BUMPS)
    (found,) = warned(of, RIGHT, name="floor.bsdf.scale")
    assert "lacks a jump inside the faces of floor: its normal or bump map flips" in str(found.message)
    assert (found.filename, found.lineno) == (__file__, line_of_render())
    still = Moving((False, False, False), False)

    def terms(scale):
        at = of.replace({"floor.bsdf.scale": scale})
        return jd.derivative_terms(at, jax.random.key(0), 1, jd.PathTracer(2, RIGHT), still)

    with pytest.warns(jd.EstimatorWarning, match="a jump inside the faces of floor"):
        jax.eval_shape(lambda x: jax.jvp(terms, (x,), (x,)), of.parameters()["floor.bsdf.scale"])
