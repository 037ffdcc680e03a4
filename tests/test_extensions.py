"""What users add in files of their own: a BSDF, a light, an environment and an estimator, whose derivatives are right.

None of their parameters has a name that the library knows.
"""

import inspect
import sys
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from examples.half_sky import HalfSky
from examples.stretched_mirror import StretchedMirror
from examples.swinging_lamp import SwingingLamp
from examples.uniform_edges import UniformEdges
from jaxdr.boundary.shared.texture_jumps import MOVED_MAPS
from jaxdr.moving import moving_in
from jaxdr.scene.bsdf import BSDF, Adapter
from jaxdr.scene.bsdf.base import no_delta
from jaxdr.scene.camera import Camera
from jaxdr.scene.emitters import Environment
from jaxdr.scene.lights import DeltaLight
from jaxdr.scene.packed_lights import group_lights
from jaxdr.scene.textures import Texture

KEYS = [jax.random.key(i) for i in range(8)]
DOWN = jd.Perspective(jd.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]), 30.0, jd.Film(8, 8, jd.Box()))
FLOOR = jd.Shape(jd.shapes.rectangle(8.0, 8.0))


def panel(height, emitter=None):
    """A square beside the camera's axis that faces down."""
    corners = [[0.8, -0.4, height], [0.8, 0.4, height], [1.6, 0.4, height], [1.6, -0.4, height]]
    return jd.Shape(jd.Mesh(corners, [[0, 1, 2], [0, 2, 3]]), jd.TwoSided(jd.Diffuse(0.0)), emitter)


MIRROR = jd.Shape(jd.shapes.rectangle(8.0, 8.0), StretchedMirror(1.3))
SCENES = {
    "floor.bsdf.stretch": jd.Scene({"floor": MIRROR, "panel": panel(3.0, jd.AreaEmitter(5.0))}, DOWN),
    "lamp.angle": jd.Scene({"floor": FLOOR, "panel": panel(1.0)}, DOWN, lights={"lamp": SwingingLamp((1.5, 0.0, 4.0))}),
    "environment.azimuth": jd.Scene({"floor": FLOOR, "panel": panel(0.6)}, DOWN, HalfSky(2.0, 0.7)),
}
INTEGRATORS = {name: jd.PathTracer(max_depth=2) for name in SCENES}
INTEGRATORS["environment.azimuth"] = jd.PathTracer(2, UniformEdges(points=8))


@partial(jax.jit, static_argnums=(0, 1, 2, 3))
def derivative(name, integrator, spp, step, key):
    """Of the image [8, 8] by a parameter: `render`'s, or with a `step` central differences."""
    scene = SCENES[name]
    here = scene.parameters()[name]

    def image(t):
        return jd.render(scene.replace({name: here + t}), key, spp=spp, integrator=integrator).mean(-1)

    if step is None:
        return jax.jvp(image, (0.0,), (1.0,))[1]
    return (image(step) - image(-step)) / (2 * step)


MIRROR_TAKES_LONG = pytest.param("floor.bsdf.stretch", marks=pytest.mark.slow)


@pytest.mark.parametrize("name", [MIRROR_TAKES_LONG, "lamp.angle", "environment.azimuth"])
def test_derivatives_are_right(name):
    """By quarters of the film."""

    def quarters(integrator, spp, step):
        images = np.stack([derivative(name, integrator, spp, step, key) for key in KEYS])
        return images.reshape(len(KEYS), 2, 4, 2, 4).mean((2, 4))

    found = quarters(INTEGRATORS[name], 128, None)
    right = quarters(jd.PathTracer(2, boundary=None), 16384, 0.03)
    error = np.sqrt((found.var(0, ddof=1) + right.var(0, ddof=1)) / len(KEYS))
    size = np.abs(right.mean(0)).max()
    assert np.all(error < 0.06 * size), (error, size)
    apart = np.abs(found.mean(0) - right.mean(0))
    assert np.all(apart < 4.5 * error + 1e-3 * size), (found.mean(0), right.mean(0), error)


def moves(scene, name):
    """What moves by one parameter of a scene."""
    here = scene.parameters()[name]
    return moving_in(scene, jax.tree.map(lambda leaf: leaf is here, scene))


def test_only_what_moves_counts():
    """Parameters of the same parts that leave all shadows and reflections where they are bring no terms."""
    for name, scene in SCENES.items():
        assert moves(scene, name).any
    assert not moves(SCENES["lamp.angle"], "lamp.intensity").any
    assert not moves(SCENES["lamp.angle"], "floor.bsdf.reflectance").any
    assert not moves(SCENES["environment.azimuth"], "environment.radiance").any


@pytest.mark.parametrize(
    "kind, method",
    [(Environment, "turn"), (DeltaLight, "borders"), (Camera, "aperture"), (Adapter, "adjoint_delta")],
)
def test_what_cannot_be_forgotten(kind, method):
    """A class without it can't be made."""
    missing = {*kind.__abstractmethods__, *kind.__abstractclassvars__}
    assert method in missing


def test_a_bsdf_with_another_inside_is_an_adapter():
    class Varnish(BSDF):
        layers: list[BSDF]
        eval = pdf = sample = None

    with pytest.raises(TypeError, match="Varnish holds a BSDF: make it a subclass of"):
        Varnish([jd.Diffuse()])


def test_delta_lobes_need_no_mark():
    class Half(jd.Diffuse):
        def sample_delta(self, wi, u):
            return no_delta(wi)

    assert Half().delta and not jd.Diffuse().delta and jd.Mask(0.5, jd.Diffuse()).delta


def test_borders_of_lights_are_never_left_out():
    class Slit(SwingingLamp):
        def borders(self):
            return jnp.zeros((1, 3, 3))

    groups = group_lights([Slit((0, 0, 1)), SwingingLamp((0, 0, 1)), SwingingLamp((0, 0, 2))])
    assert [group.stacked for group in groups] == [False, True]


def test_a_texture_that_jumps_may_not_slide():
    class Bands(Texture):
        values_of: jax.Array
        phase: jax.Array
        continuous = False

        def data(self):
            return (self.values_of,)

        def lookup(self, row, point):
            return self.values_of[row]

    bands = Bands(jnp.ones((1, 3)), jnp.asarray(0.0))
    square = jd.shapes.rectangle()
    scene = jd.Scene({"floor": jd.Shape(square, jd.Diffuse(bands))}, DOWN, jd.ConstantEnvironment())
    still = jax.tree.map(lambda _: False, scene)
    assert MOVED_MAPS.message(eqx.tree_at(lambda s: s.shapes["floor"].bsdf.reflectance.values_of, still, True)) is None
    refused = MOVED_MAPS.message(eqx.tree_at(lambda s: s.shapes["floor"].bsdf.reflectance.phase, still, True))
    assert refused is not None and "has no derivative" in refused


def test_classes_are_abstract_or_final():
    """None that can be made has subclasses: what a class does is read in one place."""
    modules = [name for name in sys.modules if name.startswith("jaxdr.")]
    kinds = {kind for name in modules for kind in vars(sys.modules[name]).values() if isinstance(kind, type)}
    kinds = {kind for kind in kinds if issubclass(kind, eqx.Module) and kind.__module__.startswith("jaxdr.")}
    made = {kind for kind in kinds if not (inspect.isabstract(kind) or kind.__abstractclassvars__)}
    assert {base.__name__ for kind in kinds for base in kind.__bases__ if base in made} == set()
