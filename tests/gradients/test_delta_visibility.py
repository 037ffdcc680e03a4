"""Objects seen in mirrors and through smooth glass: gradient images against scenes without, and finite differences.

A plane mirror shows what a window would, behind which the scene is mirrored: there the silhouettes are seen directly,
by an estimator that other tests check. For glass there are finite differences, of black objects before a sky of one:
their images are areas, with little noise.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.film import film_chains
from jaxdr.geometry.shapes import sphere

SIZE = 16
BLACK, SKY = jd.Diffuse(0.0), jd.ConstantEnvironment(1.0)
GLASS = jd.Dielectric(1.5, 1.0)
UPSIDE_DOWN = np.array([1.0, 1.0, -1.0])
MOTION = np.array([0.3, 0.2, 1.0])


class Nothing(eqx.Module):
    """No boundary behind the first surface that spreads light: where that is black there is none."""

    name: ClassVar[str] = "boundary"

    def prepare(self, context, key):
        return None

    def draw(self, context, state, chunk, key):
        raise AssertionError("it prepares nothing")

    def image(self, context, state, chunk, held, answers):
        raise AssertionError("it prepares nothing")


def quad(centre, one, two) -> jd.Mesh:
    """A parallelogram with these half sides; it looks along one x two."""
    centre, one, two = (np.asarray(v, float) for v in (centre, one, two))
    corners = np.stack([centre - one - two, centre + one - two, centre + one + two, centre - one + two])
    return jd.Mesh(corners, [[0, 1, 2], [0, 2, 3]])


def flat(height, down: bool = False, half=3.0) -> jd.Mesh:
    return quad([0, 0, height], [half, 0, 0], [0, -half if down else half, 0])


def tetrahedron(centre, size) -> jd.Mesh:
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) @ turn.T
    return jd.Mesh(corners * size + np.asarray(centre), [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])


def mirrored(shape: jd.Shape) -> jd.Shape:
    mesh = shape.mesh
    return jd.Shape(
        jd.Mesh(np.asarray(mesh.vertices) * UPSIDE_DOWN, np.asarray(mesh.faces)[:, ::-1]), shape.bsdf, shape.emitter
    )


def oblique(pixel_filter=None, lens=None) -> jd.Perspective | jd.ThinLens:
    """Looks down at the origin from the side; nothing above the mirror is seen directly."""
    pose, film = jd.look_at([0, -4, 3], [0, 0, 0], [0, 0, 1]), jd.Film(SIZE, SIZE, pixel_filter or jd.Box())
    return jd.Perspective(pose, 24.0, film) if lens is None else jd.ThinLens(pose, 24.0, film, lens, 6.0)


def above() -> jd.Perspective:
    return jd.Perspective(jd.look_at([0.7, -1.5, 5], [0, 0, 0], [0, 1, 0]), 26.0, jd.Film(SIZE, SIZE, jd.Box()))


class Images(NamedTuple):
    """Of several keys, [keys, H, W, 3]."""

    each: np.ndarray

    @property
    def mean(self):
        return self.each.mean(0)

    @property
    def error(self):
        """Standard error of the mean, all pixels together."""
        return np.sqrt((self.each.var(0, ddof=1) / len(self.each)).sum())


def gradients(scene, name, motion, max_depth, keys, spp=64, boundary=None) -> Images:
    integrator = jd.PathTracer(max_depth=max_depth, boundary=boundary or Nothing())
    value = scene.parameters()[name]
    motion = jnp.broadcast_to(jnp.asarray(motion, value.dtype), value.shape)

    @jax.jit
    def image(key):
        def moved(v):
            return jd.render(scene.replace({name: v}), key, spp, integrator)

        return jax.jvp(moved, (value,), (motion,))[1]

    return Images(np.stack([np.asarray(image(key)) for key in jax.random.split(jax.random.key(0), keys)]))


def differences(scene, name, motion, max_depth, keys, step=5e-3, spp=2048) -> Images:
    integrator = jd.PathTracer(max_depth=max_depth, boundary=None)
    value = scene.parameters()[name]
    motion = jnp.broadcast_to(jnp.asarray(motion, value.dtype), value.shape)

    @jax.jit
    def image(key):
        plus, minus = (
            jd.render(scene.replace({name: value + s * motion}), key, spp, integrator) for s in (step, -step)
        )
        return (plus - minus) / (2 * step)

    return Images(np.stack([np.asarray(image(key)) for key in jax.random.split(jax.random.key(1), keys)]))


def check(found: Images, truth: Images, within=0.05):
    """Both relative L1 and L2 differences, noise and all, and no bias of the projection beyond four standard errors."""
    difference, size = found.mean - truth.mean, np.linalg.norm(truth.mean)
    noise = np.hypot(found.error, truth.error) / size
    assert np.isfinite(found.each).all()
    assert noise < 0.8 * within, f"too few samples: {noise:.3f}"
    assert np.linalg.norm(difference) < within * size, np.linalg.norm(difference) / size
    assert np.abs(difference).sum() < within * np.abs(truth.mean).sum()
    onto = [(images.each * truth.mean).sum((1, 2, 3)) / size**2 for images in (found, truth)]
    deviation = np.hypot(*(x.std(ddof=1) / len(x) ** 0.5 for x in onto))
    assert abs(onto[0].mean() - onto[1].mean()) < 4 * deviation + 2e-3, (onto[0].mean(), onto[1].mean(), deviation)


OBJECT = jd.Shape(tetrahedron([0, 1.2, 1.6], 0.4), BLACK)
TINT = np.array([0.9, 0.8, 0.7])


def before_a_mirror(mirror: jd.Mesh, camera=None, **shapes) -> jd.Scene:
    shapes = {"mirror": jd.Shape(mirror, jd.Conductor(specular_reflectance=TINT)), "object": OBJECT} | shapes
    return jd.Scene(shapes, camera or oblique(), SKY)


def behind_a_window(camera=None) -> jd.Scene:
    return jd.Scene({"object": mirrored(OBJECT)}, camera or oblique(), SKY)


def test_in_a_mirror():
    found = gradients(before_a_mirror(flat(0)), "object.vertices", MOTION, 2, 16)
    truth = gradients(behind_a_window(), "object.vertices", MOTION * UPSIDE_DOWN, 1, 4)
    check(found, truth._replace(each=truth.each * TINT))


@pytest.mark.slow
@pytest.mark.parametrize("camera", [oblique(jd.Gaussian()), oblique(lens=0.3)], ids=["gaussian", "lens"])
def test_in_a_mirror_by_other_cameras(camera):
    found = gradients(before_a_mirror(flat(0), camera), "object.vertices", MOTION, 2, 32)
    truth = gradients(behind_a_window(camera), "object.vertices", MOTION * UPSIDE_DOWN, 1, 32)
    check(found, truth._replace(each=truth.each * TINT))


def louvre() -> jd.Mesh:
    """Strips of mirror with gaps, both narrower than a pixel: most chords begin where no edge is to be seen."""
    strips = [quad([0, y, 0], [3, 0, 0], [0, 0.04, 0]) for y in np.arange(-1.0, 1.01, 0.2)]
    points = np.concatenate([strip.vertices for strip in strips])
    return jd.Mesh(points, np.concatenate([np.asarray(strip.faces) + 4 * i for i, strip in enumerate(strips)]))


@pytest.mark.slow
def test_in_strips_of_a_mirror(monkeypatch):
    """Trials make up for the centres that find nothing; without them most of the derivative is missing."""
    scene = before_a_mirror(louvre())
    truth = differences(scene, "object.vertices", MOTION, 2, 8)
    check(gradients(scene, "object.vertices", MOTION, 2, 64), truth)
    monkeypatch.setattr(film_chains, "TRIALS", 1)
    jax.clear_caches()
    with pytest.warns(UserWarning, match="not found again in 1 trials"):
        found = gradients(scene, "object.vertices", MOTION, 2, 8)
    assert 0.2 < (found.mean * truth.mean).sum() / (truth.mean**2).sum() < 0.8


@pytest.mark.slow
def test_it_does_not_matter_how_many_trials_are_made_at_once(monkeypatch):
    scene = before_a_mirror(louvre())
    expected = gradients(scene, "object.vertices", MOTION, 2, 1, spp=4)
    monkeypatch.setattr(film_chains, "PLACES", 1 << 20)
    monkeypatch.setattr(film_chains, "LEAST_PLACES", 48)
    jax.clear_caches()
    found = gradients(scene, "object.vertices", MOTION, 2, 1, spp=4)
    assert np.abs(expected.each).max() > 0
    np.testing.assert_allclose(found.each, expected.each, rtol=1e-4, atol=1e-5 * np.abs(expected.each).max())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:jaxdr. the derivative lacks")
@pytest.mark.parametrize("boundary", [jd.KernelDensity(), jd.LineSampling()], ids=lambda b: type(b).__name__)
def test_lit_and_shadowed_in_a_mirror(boundary):
    """What is shaded in the mirror has creases there, casts shadows, and slides along rays that begin at the camera."""
    grey = jd.TwoSided(jd.Diffuse([0.7, 0.5, 0.3]))
    shapes = {
        "object": jd.Shape(OBJECT.mesh, jd.Diffuse(0.8)),
        "wall": jd.Shape(quad([0, 2.6, 2.0], [2, 0, 0], [0, 0, 1.9]), grey),
        "lamp": jd.Shape(quad([0.8, -0.6, 3.5], [0.5, 0, 0], [0, 0.4, -0.3]), BLACK, jd.AreaEmitter(30.0)),
    }
    mirror = {"mirror": jd.Shape(flat(0), jd.Conductor())}
    found = gradients(jd.Scene(shapes | mirror, oblique()), "object.vertices", MOTION, 3, 32, boundary=boundary)
    window = jd.Scene({name: mirrored(shape) for name, shape in shapes.items()}, oblique())
    truth = gradients(window, "object.vertices", MOTION * UPSIDE_DOWN, 2, 32, boundary=boundary)
    check(found, truth)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "motion"),
    [
        ("mirror.vertices", np.asarray(flat(0, half=0.6).vertices)[:, :1] * [0, 0, 0.2]),
        ("camera.to_world", np.eye(4)[:, :1] * [0, 0, 0, 1]),
    ],
    ids=["mirror", "camera"],
)
def test_the_mirror_or_the_camera_moves(name, motion):
    """The mirror tilts; the camera moves aside. Its own outline is in view, too."""
    scene = before_a_mirror(flat(0, half=0.6))
    check(gradients(scene, name, motion, 2, 32), differences(scene, name, motion, 2, 16))


WEDGE = quad([0, 0, 2.2], [3, 0, 0.5], [0, 3, 0.8])
THING = jd.Shape(tetrahedron([0, 0, 0], 0.5), BLACK)


@pytest.mark.parametrize(
    ("name", "motion"),
    [
        pytest.param("glass.bsdf.eta", 1.0, marks=pytest.mark.slow),
        pytest.param("glass.vertices", np.asarray(WEDGE.vertices)[:, :1] * [0, 0, 0.1], marks=pytest.mark.slow),
    ],
    ids=["index", "wedge"],
)
def test_through_an_interface(name, motion):
    """Glass fills all that is below; its index or its slope changes where an object in it is seen."""
    scene = jd.Scene({"glass": jd.Shape(WEDGE, GLASS), "object": THING}, above(), SKY)
    check(gradients(scene, name, motion, 2, 32), differences(scene, name, motion, 2, 64, step=1e-2))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:jaxdr. the derivative lacks")
@pytest.mark.parametrize("kind", ["slab", "pane", "bump"])
def test_through_glass(kind):
    """A slab of two interfaces, with what is reflected in it; a pane without thickness; a lens of flat faces."""
    bump = sphere(1)
    shapes = {
        "slab": {"front": jd.Shape(flat(2.2), GLASS), "back": jd.Shape(flat(1.4, down=True), GLASS)},
        "pane": {"pane": jd.Shape(flat(1.8), jd.ThinDielectric(1.5, 1.0))},
        "bump": {
            "bump": jd.Shape(jd.Mesh(np.asarray(bump.vertices) * [1.2, 1.2, 0.4] + [0, 0, 1.8], bump.faces), GLASS)
        },
    }[kind]
    scene = jd.Scene(shapes | {"object": THING}, above(), SKY)
    depth = {"slab": 4, "pane": 2, "bump": 4}[kind]
    motion = [1.0, 0.3, 0.2]
    found = gradients(scene, "object.vertices", motion, depth, 64)
    check(found, differences(scene, "object.vertices", motion, depth, 16))
