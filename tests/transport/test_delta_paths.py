"""Paths through mirrors, glass and holes: closed forms, finite differences, and what has no derivative yet."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

CORNERS = 3.0 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
GLASS, SKY = 1.5, np.array([0.3, 0.5, 0.8])
REFLECTED = ((GLASS - 1) / (GLASS + 1)) ** 2  # by one interface, from straight ahead
BLACK = jd.Diffuse(0.0)


def floor(height=0.0, slope=0.0, down: bool = False) -> jd.Mesh:
    """A square of side 6 that looks up or down; higher by `slope` x."""
    points = CORNERS + np.array([0.0, 0.0, height]) + slope * CORNERS[:, :1] * np.array([0.0, 0.0, 1.0])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return jd.Mesh(points, faces[:, ::-1] if down else faces)


def slab() -> dict[str, jd.Shape]:
    """Glass between the heights 0.8 and 1."""
    glass = jd.Dielectric(GLASS, 1.0)
    return {"front": jd.Shape(floor(1.0), glass), "back": jd.Shape(floor(0.8, down=True), glass)}


def side_lamp(height: float) -> jd.Shape:
    """A small square at x = 1 that shines towards -x."""
    points = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]) + np.array(
        [0.0, 0.0, height]
    )
    return jd.Shape(jd.Mesh(points, [[0, 2, 1], [0, 3, 2]]), BLACK, jd.AreaEmitter(20.0))


def above(shapes, environment=1.0, size=4, fov=8.0):
    """Seen from straight above."""
    camera = jd.Perspective(jd.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]), fov, jd.Film(size, size, jd.Box()))
    return jd.Scene(shapes, camera, None if environment is None else jd.ConstantEnvironment(environment))


def image(scene, max_depth, spp=256, **settings):
    integrator = jd.PathTracer(max_depth=max_depth, boundary=None, **settings)
    return np.asarray(jax.jit(lambda key: jd.render(scene, key, spp=spp, integrator=integrator))(jax.random.key(0)))


@pytest.mark.parametrize("sampling", ["mis", "emitter"])
def test_mirror_shows_the_sky(sampling):
    """A perfect mirror reflects the sky, whether emitters are looked for by BSDF sampling or not."""
    scene = above({"floor": jd.Shape(floor(), jd.Conductor(specular_reflectance=[0.9, 0.8, 0.7]))}, SKY)
    np.testing.assert_allclose(image(scene, 2, 4, sampling=sampling).mean((0, 1)), SKY * [0.9, 0.8, 0.7], rtol=1e-5)


def test_slab_of_glass():
    """A lamp behind it: nothing in two segments, what goes straight through in three."""
    scene = above(slab() | {"lamp": jd.Shape(floor(), BLACK, jd.AreaEmitter(2.0))}, None, fov=0.5)
    assert not image(scene, 2, 16).any()
    np.testing.assert_allclose(image(scene, 3, 2048).mean(), 2.0 * (1 - REFLECTED) ** 2, rtol=0.01)


def test_white_furnace_of_glass():
    """Before a sky of one nothing is lost, up to reflections that paths of seven segments miss."""
    np.testing.assert_allclose(image(above(slab()), 7, 256).mean(), 1.0, rtol=1e-4)


def test_holes():
    """A mask lets its share of the lamp below through, and hides the rest."""
    scene = above(
        {"mask": jd.Shape(floor(1.0), jd.Mask(0.3, BLACK)), "lamp": jd.Shape(floor(), BLACK, jd.AreaEmitter(2.0))}, None
    )
    np.testing.assert_allclose(image(scene, 2, 4096).mean(), 1.4, rtol=0.02)


def gradient(scene, name, motion, max_depth=4, spp=256):
    """(derivative image, mean of finite differences over the image) for a motion of one parameter."""
    integrator = jd.PathTracer(max_depth=max_depth, boundary=None)
    value = scene.parameters()[name]

    def mean(value):
        return jnp.mean(jd.render(scene.replace({name: value}), jax.random.key(1), spp=spp, integrator=integrator))

    motion = jnp.asarray(motion, value.dtype)
    step = 1e-2
    difference = (mean(value + step * motion) - mean(value - step * motion)) / (2 * step)
    return float(jax.jvp(mean, (value,), (motion,))[1]), float(difference)


def test_moving_mirror():
    """The reflection of a shaded surface slides as the mirror tilts: interior derivative, no edge in view."""
    shapes = {
        "mirror": jd.Shape(floor(), jd.Conductor()),
        "panel": jd.Shape(floor(6.0, down=True), jd.Diffuse(0.7)),
        "lamp": side_lamp(1.0),
    }
    found, difference = gradient(above(shapes, None), "mirror.vertices", floor(0.0, 0.3).vertices - CORNERS, 3, 2048)
    assert abs(difference) > 0.02
    assert abs(found - difference) < 0.03 * abs(difference)


def test_index_of_glass():
    """Of a wedge before a shaded floor: refraction and Fresnel's share."""
    shapes = {
        "glass": jd.Shape(floor(2.2, 0.2), jd.Dielectric(GLASS, 1.0)),
        "floor": jd.Shape(floor(), jd.Diffuse(0.7)),
        "lamp": side_lamp(0.5),
    }
    found, difference = gradient(above(shapes, None), "glass.bsdf.eta", 1.0, 3, 4096)
    assert abs(found - difference) < 0.05 * abs(difference), (found, difference)


MIRROR, LIGHT = jd.Shape(floor(), jd.Conductor()), jd.PointLight([0, 0, 3], 1.0)
CHECKS, MAPPED = (
    jd.Shape(jd.Mesh(floor(height).vertices, floor().faces, uvs=CORNERS[:, :2], uv_faces=floor().faces), bsdf)
    for height, bsdf in (
        (2.0, jd.Diffuse(jd.Checkerboard(0.1, 0.9))),
        (0.0, jd.NormalMap([0.5, 0.6, 0.9], jd.RoughDielectric(0.2))),
    )
)


@pytest.mark.parametrize(
    ("shapes", "lights", "settings", "message"),
    [
        ({"floor": MAPPED}, {}, {}, "seen through rough glass in a NormalMap have no deriv"),
        ({"floor": MIRROR}, {}, {"primary": "material"}, "over delta lobes have no derivative with primary"),
        ({"floor": MIRROR}, {"lamp": LIGHT}, {}, "hard shadows seen over delta lobes"),
        ({"floor": MIRROR, "checks": CHECKS}, {}, {}, "use mirrors and smooth glass that stay"),
    ],
    ids=["mapped", "material", "light", "checks"],
)
@pytest.mark.filterwarnings("ignore:jaxdr. the derivative lacks")
def test_what_has_no_derivative(shapes, lights, settings, message):
    """Said rather than left out."""
    scene = jd.Scene(shapes, above({"floor": MIRROR}).camera, jd.ConstantEnvironment(1.0), lights)
    if settings:
        gaussian = jd.Film(4, 4, jd.Gaussian())
        scene = jd.Scene(shapes, jd.Perspective(scene.camera.to_world, 8.0, gaussian), scene.environment, lights)

    def moved(vertices):
        integrator = jd.PathTracer(**settings)
        return jd.render(scene.replace({"floor.vertices": vertices}), jax.random.key(0), 1, integrator)

    vertices = scene.parameters()["floor.vertices"]
    with pytest.raises(ValueError, match=message):
        jax.eval_shape(lambda v: jax.jvp(moved, (v,), (v,)), vertices)


def test_what_is_missing_is_told():
    """Light that leaves a diffuse surface for a mirror."""
    scene = above({"floor": MIRROR, "wall": jd.Shape(floor(2.0))})
    vertices = scene.parameters()["floor.vertices"]

    def derivative(max_depth):
        def moved(vertices):
            integrator = jd.PathTracer(max_depth=max_depth)
            return jd.render(scene.replace({"floor.vertices": vertices}), jax.random.key(0), 1, integrator)

        jax.eval_shape(lambda v: jax.jvp(moved, (v,), (v,)), vertices)

    with pytest.warns(UserWarning, match="reflected/refracted light from diffuse surfaces via delta surfaces"):
        derivative(3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        derivative(2)
