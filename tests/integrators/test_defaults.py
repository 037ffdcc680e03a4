"""What is estimated with where nobody says it: by structure alone, with and without `jit`, said once."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr import cli
from jaxdr.geometry.shapes import box, plane, sphere
from jaxdr.integrators import known_failures
from jaxdr.integrators.defaults import default_integrator, default_reason
from jaxdr.moving import Moving
from tests.integrators.test_known_failures import CAMERA, ROUND, scene

SKY = jd.EnvironmentMap(np.ones((4, 8, 3)))
FLAT = plane(1.0, 4, (0.0, 0.0, 3.0))  # 32 faces


def outdoors(sky):
    return jd.Scene({"box": jd.Shape(box())}, CAMERA, sky)


def two_lamps():
    """12 faces each: 24 in all."""
    shapes = {n: jd.Shape(box(center=(x, 0, 3)), emitter=jd.AreaEmitter(1.0)) for n, x in (("a", -2.0), ("b", 2.0))}
    return jd.Scene({"ball": jd.Shape(sphere(1)), **shapes}, CAMERA)


def over_metal():
    lit = scene(ROUND)
    return jd.Scene({**lit.shapes, "floor": jd.Shape(FLAT, jd.RoughConductor(0.1))}, CAMERA)


def under_a_sky():
    return jd.Scene(scene(ROUND).shapes, CAMERA, jd.ConstantEnvironment(0.1))


def lit_by_a_spot():
    light = jd.PointLight((0.0, 0.0, 3.0), 1.0)
    return jd.Scene({"box": jd.Shape(box())}, CAMERA, lights={"light": light})


VERTICES = Moving((True,), False)
TURNS = Moving((False,), False, environment=True)
CHOSEN = {
    "a lamp of two triangles": (scene, None, jd.KernelDensity, None),
    "a lamp of twelve": (lambda: scene(box(center=(0, 0, 3))), None, jd.KernelDensity, None),
    "a round lamp": (lambda: scene(ROUND), None, jd.GuidedEdges, "more than 16 faces"),
    "a flat lamp of 32": (lambda: scene(FLAT), None, jd.GuidedEdges, "more than 16 faces"),
    "two lamps of twelve": (two_lamps, None, jd.GuidedEdges, "more than 16 faces"),
    "a round lamp with normals": (lambda: scene(ROUND.smooth()), None, jd.LineSampling, "more than 16 faces"),
    "a round lamp over metal": (lambda: over_metal(), None, jd.LineSampling, "more than 16 faces"),
    "a round lamp under a sky": (lambda: under_a_sky(), None, jd.LineSampling, "more than 16 faces"),
    "a point light": (lit_by_a_spot, None, jd.KernelDensity, None),
    "a constant sky": (lambda: outdoors(jd.ConstantEnvironment(1.0)), VERTICES, jd.KernelDensity, None),
    "a still map": (lambda: outdoors(SKY), VERTICES, jd.KernelDensity, None),
    "a map that turns": (lambda: outdoors(SKY), TURNS, jd.LineSampling, "a sky turns"),
    "a map, nobody says what moves": (lambda: outdoors(SKY), None, jd.KernelDensity, None),
}


@pytest.mark.parametrize("name", CHOSEN)
def test_what_is_chosen(name):
    made, moving, boundary, why = CHOSEN[name]
    of = made()
    chosen = default_integrator(of, moving)
    assert chosen == jd.PathTracer(boundary=boundary())
    reason = default_reason(of, moving)
    assert (reason is None) == (why is None)
    assert why is None or (why in reason and reason.startswith(f"{boundary.__name__} is taken in place of "))


def test_a_mesh_of_many_faces(monkeypatch):
    monkeypatch.setattr(known_failures, "FINE", 12)
    assert default_integrator(scene()).boundary == jd.LineSampling()
    assert "such as box" in default_reason(scene())


def test_the_depth_is_kept():
    assert default_integrator(scene(), None, 2) == jd.PathTracer(2)
    assert default_integrator(scene(ROUND), None, 2) == jd.PathTracer(2, jd.GuidedEdges())


@pytest.mark.parametrize("lamp", [None, ROUND], ids=["two triangles", "round"])
def test_tracers_choose_as_values_do(lamp):
    """All leaves of the scene are tracers here."""
    seen = []
    jax.eval_shape(lambda of: seen.append(default_integrator(of)) or 0.0, scene(lamp))
    assert seen == [default_integrator(scene(lamp))]


def said(of, name) -> list[str]:
    """What tracing a derivative says; nothing is compiled."""

    def image(value):
        return jd.render(of.replace({name: value}), jax.random.key(0), 1).sum()

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        jax.eval_shape(jax.grad(image), of.parameters()[name])
    assert all(w.filename == __file__ for w in caught if issubclass(w.category, jd.EstimatorChoice))
    return [str(w.message) for w in caught if issubclass(w.category, jd.EstimatorChoice | jd.EstimatorWarning)]


def test_a_choice_is_said_where_it_matters():
    (message,) = said(scene(ROUND), "box.vertices")
    assert message.startswith("jaxdr: no integrator was given; GuidedEdges is taken in place of KernelDensity: ")
    assert not said(scene(ROUND), "floor.bsdf.reflectance")


def test_what_turns_is_known_under_grad():
    """`render` can't know it before it is differentiated."""
    (message,) = said(outdoors(SKY), "environment.to_world")
    assert "a sky turns" in message


XML = """<scene version="3.0.0">
  <sensor type="perspective"><transform name="to_world"><lookat origin="0,-5,1" target="0,0,0" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/></film></sensor>
  <shape type="cube" id="box"/>
  <shape type="LAMP" id="lamp"><transform name="to_world"><translate z="3"/></transform>
    <emitter type="area"><rgb name="radiance" value="1,1,1"/></emitter></shape></scene>"""


@pytest.mark.parametrize("lamp, boundary", [("rectangle", jd.KernelDensity()), ("sphere", jd.LineSampling())])
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
    message = "LineSampling is taken in place of KernelDensity: "
    assert (message in capsys.readouterr().err) == (boundary == jd.LineSampling())
    assert cli.main([*arguments, "--no-cache", "--boundary", "GuidedEdges"]) == 0
    assert seen[1:] == [jd.PathTracer(2, jd.GuidedEdges())] and message not in capsys.readouterr().err
