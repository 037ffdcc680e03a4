"""`boundary="auto"`: by structure alone, the same with and without `jit`, whatever else an integrator is given."""

import copy
import pickle
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr import cli
from jaxdr.boundary.shared import traits as of_scenes
from jaxdr.boundary.shared.traits import known_failure, traits
from jaxdr.geometry.shapes import box, sphere
from jaxdr.integrators import choice
from jaxdr.integrators.choice import RULES, choose, settled, table
from tests.integrators.test_known_failures import CAMERA, ROUND, scene

SKY = jd.EnvironmentMap(np.ones((4, 8, 3)))
ROOT = Path(__file__).parents[2]


def outdoors(sky):
    return jd.Scene({"box": jd.Shape(box())}, CAMERA, sky)


def with_ball(bsdf=None, mesh=None, camera=CAMERA):
    lit = scene()
    return jd.Scene({**lit.shapes, "ball": jd.Shape(mesh or sphere(1), bsdf or jd.Diffuse(0.5))}, camera)


CHOSEN = {
    "diffuse and flat": (scene, jd.GuidedEdges),
    "a lamp that is a mesh": (lambda: scene(ROUND), jd.GuidedEdges),
    "a point light": (
        lambda: jd.Scene({"box": jd.Shape(box())}, CAMERA, lights={"light": jd.PointLight((0, 0, 3), 1.0)}),
        jd.GuidedEdges,
    ),
    "a constant sky": (lambda: outdoors(jd.ConstantEnvironment(1.0)), jd.GuidedEdges),
    "a map": (lambda: outdoors(SKY), jd.GuidedEdges),
    "two sides": (lambda: with_ball(jd.TwoSided(jd.Diffuse(0.5))), jd.GuidedEdges),
    "metal": (lambda: with_ball(jd.RoughConductor(0.1)), jd.ByKind),
    "plastic": (lambda: with_ball(jd.TwoSided(jd.RoughPlastic())), jd.ByKind),
    "rough glass": (lambda: with_ball(jd.RoughDielectric()), jd.LineSampling),
    "a mirror": (lambda: with_ball(jd.Conductor()), jd.LineSampling),
    "glass": (lambda: with_ball(jd.Dielectric()), jd.LineSampling),
    "interpolated normals": (lambda: with_ball(mesh=sphere(1).smooth()), jd.LineSampling),
    "a parallel camera": (
        lambda: with_ball(camera=jd.Orthographic(jd.look_at([0, -5, 1], [0, 0, 0], [0, 0, 1]), jd.Film(4, 4))),
        jd.LineSampling,
    ),
}


@pytest.mark.parametrize("name", CHOSEN)
def test_what_is_chosen(name):
    made, estimator = CHOSEN[name]
    of = made()
    found = choose(of)
    assert found.estimator == estimator() and found.reason.startswith(f"{estimator.__name__}, for ")
    assert known_failure(found.estimator, traits(of)) is None
    # It covers the scene: nothing is refused when a derivative is traced.
    gradient = jax.grad(lambda value: jd.render(of.replace({"box.vertices": value}), jax.random.key(0), 1).sum())
    assert jax.eval_shape(gradient, of.parameters()["box.vertices"]).shape == (8, 3)


def test_many_edges(monkeypatch):
    monkeypatch.setattr(choice, "FEW_EDGES", 20)
    assert choose(scene()).estimator == jd.LineSampling()


def test_what_fails_is_not_chosen(monkeypatch):
    monkeypatch.setattr(of_scenes, "FINE", 12)
    assert choose(scene()).estimator == jd.LineSampling()


def test_every_rule_decides_somewhere():
    of = [made() for made, _ in CHOSEN.values()]
    first = [next(rule for rule in RULES if rule.holds(s, p)) for s in of for p in ("fixed_ray", "warp")]
    assert set(map(id, first)) == set(map(id, RULES))


def test_a_depth_or_a_chunk_size_does_not_switch_the_choice_off():
    of, metal = scene(), with_ball(jd.RoughConductor(0.1))
    tracers = jd.PathTracer(2), jd.PathTracer(4, chunk_size=99), jd.PathTracer(rays="jax"), jd.PathTracer(2, "auto")
    for given in tracers:
        assert settled(given, of).boundary == jd.GuidedEdges()
        assert settled(given, metal).boundary == jd.ByKind()
        assert settled(given, of).max_depth == given.max_depth
    assert settled(jd.PathTracer(primary="warp"), of).boundary == jd.WarpedArea()
    assert settled(jd.BidirectionalPathTracer(2), of).boundary == jd.KernelDensity()


def test_what_is_named_is_kept():
    for boundary in (None, jd.KernelDensity(), jd.LineSampling(chords=2.0)):
        for given in (jd.PathTracer(2, boundary), jd.BidirectionalPathTracer(2, boundary=None)):
            assert settled(given, scene()) is given


def test_integrators_stay_values():
    """They can be compared, hashed, copied and pickled, and go through `jit` as arguments."""
    for made in (jd.PathTracer(2), jd.BidirectionalPathTracer(2)):
        assert copy.deepcopy(made) == made == pickle.loads(pickle.dumps(made)) and hash(made) == hash(type(made)(2))
        assert made != type(made)(2, boundary=None)
        assert not jax.tree.leaves(made) and jax.jit(lambda tracer: tracer)(made) == made


@pytest.mark.parametrize("wrong", ["LineSampling", "Auto", 3, jd.LineSampling])
def test_what_is_no_estimator_is_refused(wrong):
    with pytest.raises(ValueError, match='PathTracer: boundary must be "auto", an estimator such as'):
        jd.PathTracer(2, wrong)


@pytest.mark.parametrize("lamp", [None, ROUND], ids=["two triangles", "round"])
def test_tracers_choose_as_values_do(lamp):
    """All leaves of the scene are tracers here."""
    seen = []
    jax.eval_shape(lambda of: seen.append(choose(of)) or 0.0, scene(lamp))
    assert seen == [choose(scene(lamp))]


def test_nothing_is_said():
    """A library that chooses well needs no warning."""
    of = scene(ROUND)
    gradient = jax.grad(lambda value: jd.render(of.replace({"box.vertices": value}), jax.random.key(0), 1).sum())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jax.eval_shape(gradient, jnp.zeros((8, 3)))


def test_derivative_terms_choose_alike():
    of, key = scene(), jax.random.key(0)
    auto, named = (jd.derivative_terms(of, key, 1, jd.PathTracer(2, b)) for b in ("auto", jd.GuidedEdges()))
    assert auto.keys() == named.keys()


def test_the_page_has_the_rules():
    assert table() in (ROOT / "docs" / "choosing.md").read_text()


XML = """<scene version="3.0.0">
  <sensor type="perspective"><transform name="to_world"><lookat origin="0,-5,1" target="0,0,0" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/></film></sensor>
  <shape type="cube" id="box"/>
  <shape type="LAMP" id="lamp"><transform name="to_world"><translate z="3"/></transform>
    <emitter type="area"><rgb name="radiance" value="1,1,1"/></emitter></shape></scene>"""


@pytest.mark.parametrize("lamp, boundary", [("rectangle", jd.GuidedEdges()), ("sphere", jd.LineSampling())])
def test_the_command_line_chooses_alike(lamp, boundary, tmp_path, monkeypatch, capsys):
    seen = []

    def record(scene, key, spp, integrator):
        seen.append(integrator)
        return jnp.zeros((4, 4, 3)) + 0.0 * scene.parameters()["box.vertices"].sum()

    monkeypatch.setattr(cli, "render", record)
    path = tmp_path / "scene.xml"
    path.write_text(XML.replace("LAMP", lamp))
    arguments = ["gradient", str(path), "--wrt", "box.translate.x", "--max-depth", "2", "-o", str(tmp_path / "g")]
    assert cli.main([*arguments, "--no-cache"]) == 0
    assert seen == [jd.PathTracer(2, boundary)]
    message = f"jaxdr: boundary estimator: {type(boundary).__name__}, for "
    assert message in capsys.readouterr().err
    assert cli.main([*arguments, "--no-cache", "--boundary", "WarpedArea"]) == 0
    assert seen[1:] == [jd.PathTracer(2, jd.WarpedArea())] and "boundary estimator" not in capsys.readouterr().err
