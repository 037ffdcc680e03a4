"""What a scene has, which edges can carry derivatives, and which estimators are tried: counted by hand."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.shared import traits as of_scenes
from jaxdr.geometry.shapes import box, rectangle, sphere
from jaxdr.plan.candidates import candidates, splits
from jaxdr.plan.directions import direction, moving_along
from jaxdr.plan.static_look import static_look

CAMERA = jd.Perspective(jd.look_at([0, -5, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 6))


def scene(lamp=None, **lights):
    shapes = {
        "box": jd.Shape(box(), jd.RoughPlastic(0.2)),  # 12 faces, 18 edges
        "floor": jd.Shape(rectangle(8.0, 8.0, (0.0, 0.0, -1.5))),  # 2 faces, 5 edges
        "lamp": jd.Shape(lamp or rectangle(1.0, 1.0, (0.0, 0.0, 3.0)), jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
    }
    return jd.Scene(shapes, CAMERA, jd.ConstantEnvironment(0.1), lights)


def look(of, *names):
    return static_look(of, moving_along(of, names))


@pytest.mark.parametrize("away", [0.0, 1000.0])
def test_a_nudge_moves_vertices_by_rounding(away):
    """Every call of a pilot has its own, however far from the origin: acceleration structures are kept by content."""
    of = scene()
    rest = np.asarray(of.parameters()["box.vertices"]) + np.float32(away)
    along = direction(of.replace({"box.vertices": rest}), ["box.translate.x"], jax.random.key(0))
    size = np.abs(rest).max()
    for turn in (1, 2):
        moved = np.asarray(along.values["box.vertices"] + along.nudge() * turn * along.velocities["box.vertices"])
        assert 0 < np.abs(moved - rest).max() < 2e-6 * size


def test_no_nudge_where_nothing_moves():
    assert direction(scene(), ["box.bsdf.alpha"], jax.random.key(0)).nudge() == 0.0


def test_what_is_there():
    found = look(scene(spot=jd.PointLight([0, 0, 2.0], 1.0)), "box.vertices")
    assert found.lobes == {"RoughPlastic": 1, "Diffuse": 2}
    assert found.lights == {"PointLight": 1, "AreaEmitter": 1, "ConstantEnvironment": 1}
    assert (found.faces, found.traits.emitter_faces, found.textures) == (16, 2, ())
    assert found.moving == jd.Moving((True, False, False), False, (False,), False, scattering=False)


@pytest.mark.parametrize(
    ("names", "film", "still"),
    [
        (("box.vertices",), 18, 10),
        (("box.vertices", "floor.vertices"), 23, 5),
        (("camera.to_world",), 28, 0),
        (("box.bsdf.diffuse_reflectance",), 0, 28),
    ],
)
def test_edges(names, film, still):
    names = tuple(n for n in names if n in scene().parameters()) or ("floor.bsdf.reflectance",)
    found = look(scene(), *names)
    assert (found.edges, found.film_edges, found.still_edges) == (28, film, still)
    text = "\n".join(found.lines())
    assert ("no boundary terms" in text) == (film == 0)
    assert (f"{still} edges of what stands still" in text) == (film > 0 and still > 0)


def test_estimators_by_nature():
    direct = candidates(look(scene(), "box.vertices"), 2)
    assert {"LineSampling", "KernelDensity", "GuidedEdges"} <= direct.tried.keys()
    baselines = {"RednerWAS", "WarpedArea", "QuadricSampling", "MarkovChains", "WalkOnCaps"}
    assert baselines | {"AllSilhouettes"} == direct.left_out.keys()
    assert candidates(look(scene(), "box.vertices"), 5).tried.keys() == direct.tried.keys()
    assert ("ByKind" in direct.tried) == any(lobe != "Diffuse" for lobe in look(scene(), "box.vertices").lobes)
    round_lamp = candidates(look(scene(sphere(1, radius=0.3, center=(0.0, 0.0, 3.0))), "box.vertices"), 2)
    assert "KernelDensity" in round_lamp.left_out and "LineSampling" in round_lamp.tried
    assert not any(isinstance(made, jd.KernelDensity) for made in round_lamp.tried.values())
    assert len(candidates(look(scene(), "floor.bsdf.reflectance"), 2).tried) == 1


def test_fine_meshes(monkeypatch):
    monkeypatch.setattr(of_scenes, "FINE", 12)
    found = candidates(look(scene(), "floor.vertices"), 2)
    assert "box" in found.left_out["KernelDensity"]


def test_splits_of_samples():
    tracer = jd.PathTracer(2, jd.LineSampling())
    even = {"interior": 0.3, "silhouettes": 0.1, "creases": 0.1, "boundary": 0.5}
    assert splits(tracer, even) == {}
    ((what, changed),) = splits(tracer, {"silhouettes": 0.5, "creases": 0.4, "boundary": 0.1}).items()
    assert changed == jd.PathTracer(2, jd.LineSampling(), edge_samples=0.5) and "edge_samples" in what
    ((what, changed),) = splits(tracer, {"silhouettes": 0.01, "creases": 0.01, "boundary": 0.98}).items()
    assert changed == jd.PathTracer(2, jd.LineSampling(chords=4.0), edge_samples=1 / 32) and "chords=4" in what
    assert splits(jd.PathTracer(2, jd.KernelDensity()), {"interior": 0.05, "boundary": 0.95}) == {}
    assert splits(jd.BidirectionalPathTracer(), even) == {}


def test_motions_have_their_velocity_and_others_a_random_one():
    import jax

    from jaxdr.plan.directions import direction

    of = scene()
    along = direction(of, ["box.translate.x", "camera.to_world", "floor.bsdf.reflectance"], jax.random.key(0))
    np.testing.assert_array_equal(along.velocities["box.vertices"], np.broadcast_to([1.0, 0, 0], (8, 3)))
    pose, turned = of.camera.to_world, along.velocities["camera.to_world"]
    # A frame that moves stays one: R^T dR is antisymmetric.
    rate = pose[:3, :3].T @ turned[:3, :3]
    np.testing.assert_allclose(rate, -rate.T, atol=1e-6)
    assert np.any(turned[:3, 3] != 0) and not np.any(turned[3] != 0)
    assert set(direction(of, None, jax.random.key(0)).values) == {"box.vertices", "floor.vertices", "lamp.vertices"}
    for names, message in (
        (["box.vertices", "box.rotate.z"], "twice"),
        ([], "empty"),
        (["bax.vertices"], "is not a motion or parameter"),
    ):
        with pytest.raises(ValueError, match=message):
            direction(of, names, jax.random.key(0))
