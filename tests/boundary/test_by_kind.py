"""`ByKind`: parts are disjoint and complete, an estimator runs once, and bad parts are refused."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.shared import traits as of_scenes
from jaxdr.boundary.shared.kinds import KINDS, LIGHTS, LOBES, present
from jaxdr.boundary.shared.traits import known_failure, traits
from jaxdr.scene.packed import pack

LINES, EDGES = jd.LineSampling(), jd.GuidedEdges()
# Every light and every lobe is in both halves.
HALF = "emitters_diffuse", "environment_glossy", "environment_reflected", "scattered_diffuse"
MIXED = {
    "edges": EDGES,
    "half of them": jd.ByKind(EDGES, **{kind: LINES if kind in HALF else None for kind in KINDS}),
    "the other half": jd.ByKind(LINES, **{kind: EDGES if kind in HALF else None for kind in KINDS}),
}
TOGETHER, SPP, KEYS = "edges", 1024, 32
REFLECTED = tuple(kind for kind in KINDS if kind.endswith("_reflected"))


def everything(film: int = 2) -> jd.Scene:
    """Lamps and a sky, diffuse and glossy surfaces."""
    box = jd.shapes.transformed(jd.shapes.box(), np.diag([0.3, 0.3, 0.3, 1.0]))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(0.8, 0.8), jd.look_at((1.2, 0.4, 2), (0, 0, 0), (0, 1, 0)))
    left = jd.shapes.transformed(jd.shapes.plane(1.4), jd.look_at((-0.7, 0, -0.6), (-0.7, 0, 1), (0, 1, 0)))
    right = jd.shapes.transformed(jd.shapes.plane(1.4), jd.look_at((0.7, 0, -0.6), (0.7, 0, 1), (0, 1, 0)))
    shapes = {
        "box": jd.Shape(box, jd.Diffuse(0.7)),
        "left": jd.Shape(left, jd.TwoSided(jd.Diffuse(0.6))),
        "right": jd.Shape(right, jd.TwoSided(jd.RoughConductor(alpha=0.4))),
        "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(6.0)),
    }
    camera = jd.Perspective(jd.look_at((0, -1.5, 3), (0, 0, -0.3), (0, 1, 0)), 40.0, jd.Film(film, film, jd.Box()))
    return jd.Scene(shapes, camera, jd.ConstantEnvironment(0.8))


class Only(eqx.Module):
    """An estimator that is asked for some kinds alone."""

    estimator: jd.Term
    kinds: tuple[str, ...]

    name = "boundary"

    def prepare(self, context, key):
        return self.estimator.prepare(context._replace(kinds=self.kinds), key)

    def draw(self, context, *drawn):
        return self.estimator.draw(context._replace(kinds=self.kinds), *drawn)

    def image(self, context, *drawn):
        return self.estimator.image(context._replace(kinds=self.kinds), *drawn)


def growing(scene: jd.Scene, boundary: jd.Term, spp: int = SPP, keys: int = KEYS):
    """Mean and standard error of the boundary term as the box grows."""
    vertices = scene.parameters()["box.vertices"]

    def image(t, key):
        moved = scene.replace({"box.vertices": vertices * (1.0 + t)})
        return jd.derivative_terms(moved, key, spp, jd.PathTracer(3, boundary))["boundary"]

    derivative = jax.jit(lambda key: jax.jvp(lambda t: image(t, key), (0.0,), (1.0,))[1])
    rows = np.stack([np.asarray(derivative(key), float) for key in jax.random.split(jax.random.key(1), keys)])
    return rows.mean(0), rows.std(0, ddof=1) / keys**0.5


@pytest.fixture(scope="module")
def derivatives():
    """Means and standard errors of the boundary term, of all mixtures."""
    return {name: growing(everything(), boundary) for name, boundary in MIXED.items()}


@pytest.mark.parametrize("name", [name for name in MIXED if name != TOGETHER])
def test_parts_are_disjoint_and_complete(derivatives, name):
    (mean, error), (whole, other) = derivatives[name], derivatives[TOGETHER]
    scale = np.abs(whole).max()
    noise = np.hypot(error, other)
    assert noise.max() < 0.03 * scale
    assert np.all(np.abs(mean - whole) < 4.5 * noise), (mean - whole) / noise


def test_what_is_reflected():
    """Two estimators of these kinds alone agree where the camera sees a box and a wall in a very rough mirror."""
    of = everything()
    wall = jd.shapes.transformed(jd.shapes.plane(3.0), jd.look_at((0, 0, -0.6), (0, 0, 1), (0, 1, 0)))
    floor = jd.shapes.transformed(jd.shapes.plane(4.0), jd.look_at((0, -0.5, 0), (0, 1, 0), (0, 0, 1)))
    shapes = {
        **{name: of.shapes[name] for name in ("box", "lamp")},
        "wall": jd.Shape(wall, jd.TwoSided(jd.Diffuse(0.8))),
        "floor": jd.Shape(floor, jd.TwoSided(jd.RoughConductor(alpha=1.0))),
    }
    camera = jd.Perspective(jd.look_at((0, 0.3, 1.5), (0, -0.5, 0.3), (0, 1, 0)), 40.0, jd.Film(1, 1, jd.Box()))
    scene = jd.Scene(shapes, camera, of.environment)
    lines, of_lines = growing(scene, Only(LINES, REFLECTED), 4096, 8)
    edges, of_edges = growing(scene, Only(EDGES, REFLECTED), 8192, 24)
    noise = np.hypot(of_lines, of_edges)
    assert noise.max() < 0.08 * np.abs(lines).max()
    assert np.all(np.abs(lines - edges) < 4.5 * noise), (lines, edges, noise)


def test_the_term_is_there_where_it_is_zero():
    """As with other estimators: its key does not depend on what the scene has."""
    of = everything()
    dark = jd.Scene({name: of.shapes[name] for name in ("box", "right")}, of.camera)
    assert "boundary" in jd.derivative_terms(dark, jax.random.key(0), 1, jd.PathTracer(1, jd.ByKind()))


def test_what_fails_is_named(monkeypatch):
    monkeypatch.setattr(of_scenes, "FINE", 12)
    reason = known_failure(jd.ByKind(), traits(everything()))
    assert reason is not None and reason.startswith("GuidedEdges, a part of it: ")
    assert known_failure(jd.ByKind(LINES), traits(everything())) is None


def test_kinds_of_a_scene():
    of = everything()
    assert present(pack(of), 4, KINDS) == KINDS
    assert present(pack(of), 3, KINDS) == KINDS[:-1]
    assert present(pack(of), 2, KINDS) == tuple(f"{light}_{lobe}" for light in LIGHTS[:2] for lobe in LOBES[:2])
    assert present(pack(of), 1, KINDS) == ()
    diffuse = jd.Scene({name: shape for name, shape in of.shapes.items() if name != "right"}, of.camera)
    assert present(pack(diffuse), 3, KINDS) == ("emitters_diffuse", "scattered_diffuse")


def test_an_estimator_of_several_kinds_runs_once():
    parts = MIXED["half of them"].parts()
    assert [part.estimator for part in parts] == [LINES, EDGES]
    assert sorted(kind for part in parts for kind in part.kinds) == sorted(KINDS)
    (part,) = jd.ByKind(LINES, scattered_glossy=jd.LineSampling()).parts()
    assert set(part.kinds) == set(KINDS)


@pytest.mark.parametrize("wrong", [jd.KernelDensity(), jd.LineSampling])
def test_estimators_that_cover_no_single_kinds_are_refused(wrong):
    with pytest.raises(ValueError, match="ByKind: scattered_glossy must be a"):
        jd.ByKind(EDGES, scattered_glossy=wrong)
    with pytest.raises(ValueError, match="ByKind: rest must be"):
        jd.ByKind(wrong)


def test_nothing_is_asked_where_there_is_nothing():
    """Direct light of lamps on diffuse surfaces: the second estimator takes no part."""
    of, boundary = everything(), jd.ByKind(EDGES, environment_glossy=LINES, scattered_glossy=LINES)
    lit = jd.Scene({name: shape for name, shape in of.shapes.items() if name != "right"}, of.camera)

    def loss(value, boundary):
        return jd.render(lit.replace({"box.vertices": value}), jax.random.key(0), 1, jd.PathTracer(2, boundary)).sum()

    programs = [
        str(jax.make_jaxpr(jax.grad(lambda value, b=b: loss(value, b)))(lit.parameters()["box.vertices"]))
        for b in (boundary, EDGES)
    ]
    assert abs(len(programs[0]) / len(programs[1]) - 1) < 0.05
