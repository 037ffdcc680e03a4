"""`jaxdr.plan` from end to end, the pilots replaced by known numbers; its arguments, its text, its table."""

import dataclasses
import importlib
import json

import jax
import pytest

import jaxdr as jd
from jaxdr import cli
from jaxdr.geometry.shapes import box, rectangle, transformed
from jaxdr.plan.depth import DepthChoice, Share
from jaxdr.plan.pilot import Measured
from jaxdr.plan.plan import NOTHING, small_film
from jaxdr.plan.report import Plan

module = importlib.import_module("jaxdr.plan.plan")
XML = """<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0.5, -5, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film></sensor>
<shape type="cube" id="box"/><emitter type="constant"/></scene>"""


@pytest.fixture
def scene():
    down = jd.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    shapes = {
        "box": jd.Shape(box()),
        "lamp": jd.Shape(transformed(rectangle(1.0, 1.0), down), jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
    }
    return jd.Scene(shapes, jd.Perspective(jd.look_at([0, -5, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(96, 96)))


@pytest.fixture
def pilots(monkeypatch):
    """Pilots that measure nothing; the names of what they were given."""
    asked = []

    def depth(scene, along, tolerance, key):
        asked.append("depth")
        share = Share(jax.numpy.array([1.0, 0.01]), jax.numpy.zeros(2))
        return DepthChoice(2, tolerance, True, share, None)

    class Pilot:
        def __init__(self, scene, along, moving, key):
            assert scene.camera.film.width <= 48

        def __call__(self, settings):
            asked.append(list(settings))
            shares = {"interior": 0.1, "silhouettes": 0.1, "boundary": 0.8}

            def one(integrator, spp):
                line = isinstance(integrator.boundary, jd.LineSampling)
                work = 0.1 if line and integrator.boundary.chords == 4 else 0.2 if line else 1.0
                return Measured(spp, 0.01 * spp, work / spp, shares)

            return {name: one(*setting) for name, setting in settings.items()}

    monkeypatch.setattr(module, "choose_depth", depth)
    monkeypatch.setattr(module, "Pilot", Pilot)
    return asked


def test_everything_is_chosen_and_explained(scene, pilots):
    found = jd.plan(scene, ["box.translate.x"], 2.0)
    assert found.integrator == jd.PathTracer(2, jd.LineSampling(chords=4.0))
    assert found.spp == 50  # 2 s for four times the pilot's pixels
    text = str(found)
    for start in ("lobes: Diffuse", "lights: AreaEmitter", "edges: 1 of 2", "depth: 2", "estimator: Line"):
        assert any(line.startswith(start) for line in found.lines), start
    assert "not tried: RednerWAS" in text and "chords=4" in text and len(text.splitlines()) == len(found.lines)


def test_it_can_be_kept(scene, pilots):
    found = jd.plan(scene, ["box.vertices"])
    again = Plan.from_dict(json.loads(json.dumps(found.to_dict())))
    assert again == found and again.integrator == found.integrator
    guided = Plan(jd.PathTracer(2, jd.GuidedEdges(cells=(8, 4, 4))), 3, ("x",))
    assert Plan.from_dict(json.loads(json.dumps(guided.to_dict()))) == guided
    parts = Plan(jd.PathTracer(2, jd.ByKind(jd.LineSampling(chords=2.0), environment_diffuse=jd.GuidedEdges())), 3, ())
    assert Plan.from_dict(json.loads(json.dumps(parts.to_dict()))) == parts
    interior = Plan(jd.BidirectionalPathTracer(5), 3, ())
    assert Plan.from_dict(json.loads(json.dumps(interior.to_dict()))) == interior
    other = {"integrator": {"kind": "Other", "boundary": None}, "spp": 1, "lines": [], "figures": {}}
    older = found.to_dict() | {"integrator": found.to_dict()["integrator"] | {"antithetic": False}}
    for bad in ({}, other, older):
        with pytest.raises(ValueError, match="not a plan"):
            Plan.from_dict(bad)


def test_what_is_given_is_kept(scene, pilots):
    assert jd.plan(scene, max_depth=5).integrator.max_depth == 5
    assert "depth" not in pilots
    assert jd.plan(scene, spp=3).spp == 3
    own = jd.KernelDensity(radius=0.01)
    assert jd.plan(scene, boundary=own).integrator.boundary == own
    assert jd.plan(scene, boundary=None).integrator.boundary is None
    pilots.clear()
    whole = jd.PathTracer(7, jd.WarpedArea())
    found = jd.plan(scene, integrator=whole)
    assert found.integrator == whole and all(names == ["as asked for"] for names in pilots)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"budget": 0.0}, "budget must be positive"),
        ({"spp": 0}, "spp must be a positive whole number"),
        ({"max_depth": 0}, "max_depth must be a positive whole number"),
        ({"depth_tolerance": 0.0}, "depth_tolerance must be positive"),
        ({"integrator": jd.PathTracer(), "max_depth": 2}, "leave those out"),
        ({"boundary": "LineSampling"}, "boundary must be an estimator such as"),
        ({"params": ["bix.vertices"]}, "is not a motion or parameter"),
    ],
)
def test_mistakes(scene, options, message):
    with pytest.raises(ValueError, match=message):
        jd.plan(scene, **options)


def test_not_under_jit(scene):
    with pytest.raises(ValueError, match="can't run under jit"):
        jax.jit(lambda s: jd.plan(s).spp)(scene)


def test_a_smaller_film_sees_the_same(scene):
    small, ratio = small_film(scene)
    assert (small.camera.film.width, small.camera.film.height, ratio) == (48, 48, 4.0)
    low, high = small.camera.view().rays(jax.numpy.array([[0.0, 0.0], [48.0, 48.0]]))[1]
    for corner, ray in (((0.0, 0.0), low), ((96.0, 96.0), high)):
        assert abs(scene.camera.view().rays(jax.numpy.array([corner]))[1] - ray).max() < 1e-6
    film = jd.Film(400, 200, crop=(300, 20, 100, 100))
    camera = jd.Perspective(scene.camera.to_world, 40.0, film)
    cropped, ratio = small_film(jd.Scene(scene.shapes, camera))
    assert cropped.camera.film.crop == (144, 9, 48, 48) and 4 < ratio < 5
    assert small_film(small)[0] is small


def test_the_command(monkeypatch, tmp_path, capsys):
    (tmp_path / "scene.xml").write_text(XML)
    asked = {}

    def fake(scene, params, budget, **options):
        asked.update(options, params=params, budget=budget)
        return Plan(jd.PathTracer(2), 8, ("depth: 2", "samples: 8"), {"chosen": "x"})

    monkeypatch.setattr(cli, "plan", fake)
    path = str(tmp_path / "scene.xml")
    assert cli.main(["plan", path, "--wrt", "box.translate.x", "--budget", "0.5", "--boundary", "LineSampling"]) == 0
    assert capsys.readouterr().out == "depth: 2\nsamples: 8\n"
    assert asked["params"] == ["box.translate.x"] and asked["budget"] == 0.5
    assert asked["boundary"] == jd.LineSampling() and asked["max_depth"] is None
    assert cli.main(["plan", path, "--json"]) == 0
    assert Plan.from_dict(json.loads(capsys.readouterr().out)).spp == 8
    assert asked["params"] is None and asked["boundary"] == "auto"
    assert cli.main(["plan", path, "--budget", "0"]) == 2
    assert "must be positive" in capsys.readouterr().err


@pytest.mark.slow
def test_real_pilots(scene):
    """A box and its shadowless lamp: something right is chosen within the candidates, and it renders."""
    small, _ = small_film(scene)
    found = jd.plan(small, ["box.translate.x"], 0.2, max_depth=2)
    assert isinstance(found.integrator, jd.PathTracer) and found.spp >= 1
    assert found.figures["rounds"][0]["LineSampling"]["variance"] > 0
    jd.render(small, jax.random.key(0), found.spp, found.integrator)
    assert NOTHING not in found.lines


@pytest.mark.slow
def test_a_dark_scene(scene):
    """The plan says that there is nothing to go by."""
    lamp = dataclasses.replace(scene.shapes["lamp"], emitter=jd.AreaEmitter(0.0))
    dark = dataclasses.replace(scene, shapes={**scene.shapes, "lamp": lamp})
    assert NOTHING in jd.plan(small_film(dark)[0], ["box.translate.x"], 0.2, max_depth=2).lines
