"""Path tracing against closed forms: furnaces, a rectangle's light, and what `max_depth` and the samplers mean."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments import program_size
from jaxdr.geometry.shapes import box, rectangle, sphere, transformed
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import intersect, on_fixed_ray
from jaxdr.transport.path import trace_paths
from jaxdr.transport.path_settings import PathSettings
from tests.references.polygon_shadow import irradiance

UP = [0, 0, 1]
RGB = np.array([0.2, 0.5, 0.8])


def camera(origin, target, fov=20.0, size=8):
    return jd.Perspective(jd.look_at(origin, target, UP), fov, jd.Film(size, size, jd.Box()))


def inside_out(mesh: jd.Mesh) -> jd.Mesh:
    return jd.Mesh(mesh.vertices, np.asarray(mesh.faces)[:, ::-1])


@partial(jax.jit, static_argnames=("spp", "max_depth", "sampling", "rays"))
def image(scene, key, spp, max_depth, sampling="mis", rays="auto"):
    integrator = jd.PathTracer(max_depth=max_depth, boundary=None, sampling=sampling, rays=rays)
    return jd.render(scene, key, spp=spp, integrator=integrator)


@cache
def closed_room(emission=1.5):
    """A box seen from within: every surface glows and reflects."""
    room = inside_out(box((2.0, 2.0, 2.0)))
    shape = jd.Shape(room, jd.Diffuse(RGB), jd.AreaEmitter(emission))
    return jd.Scene({"room": shape}, camera([0.3, -0.2, 0.1], [1.0, 0.4, 0.2], fov=80.0))


@pytest.mark.parametrize("depth, sampling", [(1, "mis"), (4, "mis"), (3, "emitter")])
def test_furnace(depth, sampling):
    """Inside of a glowing closed surface every direction brings L = Lₑ (1 - ρⁿ) / (1 - ρ) after n segments."""
    exact = 1.5 * (1 - RGB**depth) / (1 - RGB)
    if depth == 1:
        np.testing.assert_allclose(image(closed_room(), jax.random.key(0), 1, 1, sampling), 1.5, rtol=1e-6)
        return
    # Emitter sampling alone has infinite variance where walls meet, hence its slow convergence; MIS has next to none.
    rows = [
        image(closed_room(), key, 64, depth, sampling).mean((0, 1)) for key in jax.random.split(jax.random.key(1), 8)
    ]
    mean, error = np.mean(rows, 0), np.std(rows, 0, ddof=1) / np.sqrt(8)
    assert np.all(error < (0.003 if sampling == "mis" else 0.05) * exact)
    assert np.all(np.abs(mean - exact) < 4 * error + 1e-5), f"{mean} ± {error}, exactly {exact}"


def test_furnace_outside_a_convex_body():
    """A convex body under a constant sky reflects ρ L from everywhere, at any depth from two on."""
    scene = jd.Scene(
        {"ball": jd.Shape(sphere(2), jd.Diffuse(RGB))},
        camera([0, -4, 1], [0, 0, 0], fov=10.0),
        jd.ConstantEnvironment(2.0),
    )
    pixels = np.asarray(image(scene, jax.random.key(2), 256, 3)).reshape(-1, 3)
    mean, error = pixels.mean(0), pixels.std(0, ddof=1) / np.sqrt(len(pixels))
    assert np.all(error < 0.002) and np.all(np.abs(mean - 2.0 * RGB) < 4 * error + 1e-6)


def rectangle_light():
    """A floor under a square light, a camera that looks at one point of the floor, and the light's outline."""
    outline = np.array([[-0.8, -0.8, 1.0], [-0.8, 0.8, 1.0], [0.8, 0.8, 1.0], [0.8, -0.8, 1.0]])
    scene = jd.Scene(
        {
            "floor": jd.Shape(rectangle(8.0, 8.0), jd.Diffuse(RGB)),
            "light": jd.Shape(jd.Mesh(outline, [[0, 1, 2], [0, 2, 3]]), jd.Diffuse(0.0), jd.AreaEmitter((3, 2, 1))),
        },
        camera([1.5, -3.0, 0.6], [0.4, 0.1, 0.0], fov=0.02),
    )
    return scene, outline


@pytest.mark.parametrize("sampling, rays", [("mis", "warp"), ("emitter", "jax")])
def test_direct_light_of_a_rectangle(sampling, rays):
    """Lambert's contour formula."""
    scene, outline = rectangle_light()
    exact = RGB / np.pi * [3.0, 2.0, 1.0] * irradiance(np.array([0.4, 0.1, 0.0]), UP, outline)
    assert np.all(exact > 0.01)
    pixels = np.asarray(image(scene, jax.random.key(4), 256 if rays == "warp" else 64, 2, sampling, rays)).reshape(
        -1, 3
    )
    mean, error = pixels.mean(0), pixels.std(0, ddof=1) / np.sqrt(len(pixels))
    assert np.all(error < 0.003 * exact)
    assert np.all(np.abs(mean - exact) < 4 * error), f"{mean} ± {error}, exactly {exact}"


@cache
def cluttered():
    """A box on a floor below a light, under a dim sky: occlusion, interreflection, two kinds of emitters."""
    floor = rectangle(6.0, 6.0)
    light = transformed(rectangle(1.0, 1.0), np.array([[1, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1.0]]))
    return jd.Scene(
        {
            "box": jd.Shape(box((0.8, 0.8, 0.8), (0.0, 0.0, 0.4)), jd.Diffuse((0.7, 0.3, 0.2))),
            "floor": jd.Shape(floor, jd.TwoSided(jd.Diffuse(0.6))),
            "light": jd.Shape(light, jd.Diffuse(0.3), jd.AreaEmitter(4.0)),
        },
        camera([1.5, -4.0, 2.5], [0, 0, 0.3], fov=40.0),
        jd.ConstantEnvironment(0.3),
    )


def block_means(scene, key, spp, depth, sampling, keys=12):
    """Means of 4 x 4 blocks of pixels over keys, and their standard errors."""
    images = np.stack([image(scene, k, spp, depth, sampling) for k in jax.random.split(key, keys)])
    blocks = images.reshape(keys, 2, 4, 2, 4, 3).mean((2, 4)).reshape(keys, -1)
    return blocks.mean(0), blocks.std(0, ddof=1) / np.sqrt(keys)


def test_mis_and_emitter_sampling_agree():
    (a, da), (b, db) = (block_means(cluttered(), jax.random.key(5), 64, 3, s) for s in ("mis", "emitter"))
    error = np.hypot(da, db)
    assert np.all(error < 0.02 * a.mean())
    assert np.max(np.abs(a - b) / error) < 4.5, (a, b, error)  # 12 numbers of 12 keys each: Student's t


def test_max_depth_counts_segments():
    """1: emitters seen directly; 2: what they light; 3: what that lights."""
    images = [np.asarray(image(cluttered(), jax.random.key(6), 64, depth)) for depth in (1, 2, 3)]
    # The light shines downwards, away from the camera: every sample sees the sky or nothing that glows.
    share = images[0] / 0.3 * 64
    np.testing.assert_allclose(share, np.round(share), atol=1e-3)
    assert 0 < share.mean() < 64
    gains = np.diff([i.mean() for i in images])
    assert 0 < gains[1] < 0.6 * gains[0], gains


def program(depth, sampling="mis", boundary=None, spp=4, chunk_size=1 << 16):
    integrator = jd.PathTracer(depth, boundary, sampling=sampling, chunk_size=chunk_size)

    def run(parameters, key):
        return jd.render(cluttered().replace(parameters), key, spp, integrator).sum()

    traced = jax.make_jaxpr(jax.value_and_grad(run))(cluttered().parameters(), jax.random.key(0))
    return len(list(program_size.equations(traced.jaxpr)))


@pytest.mark.parametrize(
    "sampling, boundary", [("emitter", None), pytest.param("mis", jd.KernelDensity(), marks=pytest.mark.slow)]
)
def test_program_does_not_grow_with_depth(sampling, boundary):
    """Bounces run in a loop: once it turns more than once, a larger depth adds no equation."""
    assert program(9, sampling, boundary) == program(5, sampling, boundary)


def test_program_does_not_grow_with_samples():
    """8 x 8 pixels in chunks of sixteen samples each (images take four times as many as it says): four or sixteen."""
    assert program(3, spp=64, chunk_size=256) == program(3, spp=256, chunk_size=256)


def test_radiance_is_never_negative_nor_infinite():
    pixels = np.asarray(image(cluttered(), jax.random.key(7), 64, 3))
    assert np.all(np.isfinite(pixels)) and np.all(pixels >= 0)


@partial(jax.jit, static_argnames="depth")
def first_hits_and_record(scene, film_points, key, depth):
    packed, count = pack(scene), len(film_points)
    origin, direction = scene.camera.rays(film_points)
    origin = jnp.broadcast_to(origin, direction.shape)
    face = intersect(packed, origin, direction, jnp.ones(count, bool), "warp").face
    first = on_fixed_ray(packed, origin, direction, face)
    u = jax.random.uniform(key, (count, 4))
    return first, trace_paths(packed, first, direction, u, key, PathSettings(depth, True, "warp"))


def test_record_of_segments():
    """Apexes and targets are where the path went; hidden connections are there and marked."""
    film_points = jnp.asarray(np.random.default_rng(8).uniform(0, 8, (200, 2)), jnp.float32)
    arguments = (cluttered(), film_points, jax.random.key(9))
    first, record = jax.device_get(first_hits_and_record(*arguments, depth=4))
    assert record.radiance.shape == (200, 3)
    assert record.direct.apex_face.shape == (3, 200) and record.scattered.apex_face.shape == (2, 200)
    # The first segment starts at the first hit, each later one where the last scattered one ended.
    np.testing.assert_array_equal(record.direct.apex_face[0], first.face)
    for bounce in (0, 1):
        went_on = record.scattered.visible[bounce]
        target, apex = record.scattered.target_face[bounce], record.direct.apex_face[bounce + 1]
        np.testing.assert_array_equal(target[went_on], apex[went_on])
    reachable, visible = (record.direct.weight > 0).any(-1), record.direct.visible
    assert np.all(reachable[visible]) and np.any(reachable & ~visible)
    emitting = np.isin(record.direct.target_face, pack(cluttered()).emitter_faces)
    assert np.all(emitting | record.direct.infinite)
    _, emission_only = jax.eval_shape(partial(first_hits_and_record, depth=1), *arguments)
    assert emission_only.direct is None and emission_only.scattered is None
    _, direct_only = jax.eval_shape(partial(first_hits_and_record, depth=2), *arguments)
    assert direct_only.direct is not None and direct_only.scattered is None


def test_scene_without_light_is_black():
    scene = jd.Scene({"box": jd.Shape(box())}, camera([0, -3, 1], [0, 0, 0], fov=30.0))
    for depth in (1, 3):
        assert np.all(np.asarray(image(scene, jax.random.key(11), 2, depth)) == 0)


def test_emitter_of_no_power():
    """An emitter that is off, as an optimisation may start with, is no light, not a division by zero."""
    scene = cluttered().replace({"light.emitter.radiance": jnp.zeros(3)})
    pixels = np.asarray(image(scene, jax.random.key(12), 64, 3))
    assert np.all(np.isfinite(pixels)) and pixels.mean() > 0
