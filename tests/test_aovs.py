"""AOVs: closed forms, Mitsuba's `aov` integrator, errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, sphere

KEY = jax.random.key(0)
POSE = jd.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
FILM = jd.Film(12, 10, jd.Box())
CAMERAS = {
    "perspective": jd.Perspective(POSE, 60.0, FILM),
    "parallel": jd.Orthographic(POSE @ np.diag([3.0, 3.0, 1, 1]), FILM),
    "lens": jd.ThinLens(POSE, 60.0, FILM, 0.5, 2.0),
}


def wall(camera, size=30.0):
    """A wall across the axis, 5 in front of the camera; a ball behind the camera."""
    shapes = {
        "wall": jd.Shape(rectangle(size, size), jd.Diffuse((0.2, 0.5, 0.7))),
        "ball": jd.Shape(sphere(1, center=(0.0, 0.0, 9.0))),
    }
    return jd.Scene(shapes, camera)


@pytest.mark.parametrize("kind", CAMERAS)
def test_wall(kind):
    found = jd.render_aovs(wall(CAMERAS[kind]), KEY, spp=64)
    assert {name: (v.shape, v.dtype) for name, v in found.items()} == {
        "alpha": ((10, 12, 1), np.float32),
        "depth": ((10, 12, 1), np.float32),
        "position": ((10, 12, 3), np.float32),
        "shading_normal": ((10, 12, 3), np.float32),
        "albedo": ((10, 12, 3), np.float32),
        "face": ((10, 12), np.int32),
        "shape": ((10, 12), np.int32),
    }
    np.testing.assert_allclose(found["alpha"], 1.0, rtol=1e-6)
    np.testing.assert_allclose(found["albedo"], np.broadcast_to([0.2, 0.5, 0.7], (10, 12, 3)), rtol=1e-5)
    np.testing.assert_allclose(found["shading_normal"], np.broadcast_to([0, 0, 1], (10, 12, 3)), atol=1e-5)
    assert np.all(found["shape"] == 1)  # after the ball
    column, row = np.meshgrid(np.arange(12) + 0.5 - 6, 5 - np.arange(10) - 0.5)
    scale = 5 / (6 / np.tan(np.radians(30))) if kind != "parallel" else 3 / 6
    centres = np.stack([column, row], -1) * scale
    # Out of focus, the mean over the lens stays where the centre looks.
    np.testing.assert_allclose(found["position"][..., :2], centres, atol=0.1 if kind == "lens" else 0.02)
    np.testing.assert_allclose(found["position"][..., 2], 0, atol=1e-5)
    depth = np.hypot(5, np.linalg.norm(centres, axis=-1)) if kind != "parallel" else 5.0
    np.testing.assert_allclose(found["depth"][..., 0], np.broadcast_to(depth, (10, 12)), rtol=0.03)
    # The diagonal between the two faces runs through pixel centres: look beside it.
    face, beside = np.asarray(found["face"]), np.abs(centres[..., 0] - centres[..., 1]) > 1e-3
    assert np.array_equal(face[beside], np.where(centres[..., 0] > centres[..., 1], 0, 1)[beside])


def test_borders_are_mixed_and_numbers_are_not():
    """A wall that ends within pixels: means there, whole numbers at the centres; a crop window is a part of it."""
    of = wall(CAMERAS["parallel"], size=3.2)  # 3.2 / 0.5 pixels across: 2.8 to 9.2
    found = jd.render_aovs(of, KEY, spp=256, names=("shape", "alpha", "depth", "albedo"))
    assert list(found) == ["shape", "alpha", "depth", "albedo"]
    covered = np.minimum(np.clip(np.arange(12) + 1 - 2.8, 0, 1), np.clip(9.2 - np.arange(12), 0, 1))
    np.testing.assert_allclose(found["alpha"][5, :, 0], covered, atol=0.02)
    np.testing.assert_allclose(found["depth"][5, :, 0], 5 * covered, atol=0.1)
    np.testing.assert_allclose(found["albedo"][5, :, 1], 0.5 * covered, atol=0.01)
    assert found["shape"][5].tolist() == [-1] * 3 + [1] * 6 + [-1] * 3
    crop = jd.Orthographic(of.camera.to_world, jd.Film(12, 10, jd.Box(), (2, 4, 3, 2)))
    part = jd.render_aovs(jd.Scene(of.shapes, crop), KEY, spp=256, names=("shape", "depth"))
    assert np.array_equal(part["shape"], found["shape"][4:6, 2:5])
    np.testing.assert_allclose(part["depth"], found["depth"][4:6, 2:5], atol=0.1)


def test_clipped_surfaces_are_not_seen():
    near = jd.Perspective(POSE, 60.0, FILM, near_clip=5.1)
    far = jd.Perspective(POSE, 60.0, FILM, far_clip=4.9)
    for camera in (near, far):
        found = jd.render_aovs(wall(camera), KEY, spp=1, names=("shape", "depth"))
        assert np.all(found["shape"] == -1) and np.all(found["depth"] == 0)


def test_albedo_of_other_models():
    """The share of a white sky that they scatter: what a render of it shows."""
    wall = jd.Shape(rectangle(30.0, 30.0), jd.RoughConductor(0.3, "Au"))
    of = jd.Scene({"wall": wall}, CAMERAS["perspective"], jd.ConstantEnvironment(1.0))
    albedo = jd.render_aovs(of, KEY, spp=64, names=("albedo",))["albedo"]
    image = jd.render(of, jax.random.key(1), spp=64, integrator=jd.PathTracer(max_depth=2, boundary=None))
    np.testing.assert_allclose(albedo.mean((0, 1)), image.mean((0, 1)), rtol=0.005)


def test_chunks_change_nothing(monkeypatch):
    of = wall(CAMERAS["perspective"], size=3.2)
    whole = jd.render_aovs(of, KEY, spp=6, names=("position",))["position"]
    monkeypatch.setattr("jaxdr.aovs.CHUNK", 4 * 120)
    jax.clear_caches()
    np.testing.assert_allclose(jd.render_aovs(of, KEY, spp=6, names=("position",))["position"], whole, atol=1e-5)


def test_errors():
    of = wall(CAMERAS["perspective"])
    with pytest.raises(
        ValueError, match="unknown name 'dept'; known: alpha, depth, position, shading_normal, albedo, face"
    ):
        jd.render_aovs(of, KEY, names=("dept",))
    with pytest.raises(ValueError, match="spp must be a positive whole number"):
        jd.render_aovs(of, KEY, spp=0)

    def normal(fov):
        found = jd.render_aovs(of.replace({"camera.fov": fov}), KEY, spp=1, names=("depth", "shading_normal"))
        return found["shading_normal"].sum()

    with pytest.raises(ValueError, match=r"shading_normal has no derivative, .*; differentiate alpha, depth, position"):
        jax.grad(normal)(jnp.asarray(60.0))
    assert jax.grad(lambda fov: fov * normal(jax.lax.stop_gradient(fov)))(jnp.asarray(60.0)) > 0


def test_derivatives_of_a_square_that_moves():
    """Its left and right borders alone change their columns: by length x velocity x value at the border."""
    of = wall(CAMERAS["parallel"], size=3.2)
    vertices, names = of.parameters()["wall.vertices"], ("alpha", "depth", "position")

    def columns(x):
        moved = of.replace({"wall.vertices": vertices + x * jnp.asarray([1.0, 0.0, 0.0])})
        return {name: v.sum(0) for name, v in jd.render_aovs(moved, KEY, spp=16, names=names).items()}

    _, found = jax.jvp(jax.jit(columns), (0.0,), (1.0,))
    rate = np.zeros(12)  # pixels of area per scene unit
    rate[2], rate[9] = -6.4 / 0.5, 6.4 / 0.5
    np.testing.assert_allclose(found["alpha"][:, 0], rate, atol=1e-3)
    np.testing.assert_allclose(found["depth"][:, 0], 5 * rate, atol=1e-3)
    np.testing.assert_allclose(found["position"][:, 0], 1.6 * np.abs(rate), atol=1e-3)
    np.testing.assert_allclose(found["position"][:, 1:], 0.0, atol=0.5)  # y has a mean of zero along the borders


def test_derivatives_by_the_camera():
    """The front of a unit cube covers (f / d)² pixels; what is behind it, and its colour, change nothing."""
    cube = jd.Scene({"cube": jd.Shape(jd.shapes.box())}, CAMERAS["perspective"])
    pose, fov = (cube.parameters()[name] for name in ("camera.to_world", "camera.fov"))

    def coverage(back, fov, color):
        moved = {"camera.to_world": pose.at[2, 3].add(back), "camera.fov": fov, "cube.bsdf.reflectance": color}
        return jd.render_aovs(cube.replace(moved), KEY, spp=16, names=("alpha", "shape"))["alpha"].sum()

    area, found = jax.jit(jax.value_and_grad(coverage, (0, 1, 2)))(0.0, fov, jnp.full(3, 0.5))
    focal, half, distance = 6 / np.tan(np.pi / 6), np.pi / 6, 4.5
    expected = (focal / distance) ** 2
    np.testing.assert_allclose(area, expected, rtol=0.05)
    np.testing.assert_allclose(found[0], -2 * expected / distance, rtol=1e-3)
    np.testing.assert_allclose(found[1], -2 * expected / focal * 6 / np.sin(half) ** 2 * np.pi / 360, rtol=1e-3)
    assert np.all(found[2] == 0)


def test_depth_of_a_wall_that_moves_away():
    """No silhouette: the wall slides under the rays, and depth is in proportion to its distance from the camera."""
    of = wall(CAMERAS["perspective"])
    vertices = of.parameters()["wall.vertices"]

    def depth(back):
        moved = of.replace({"wall.vertices": vertices - back * jnp.asarray([0.0, 0.0, 1.0])})
        return jd.render_aovs(moved, KEY, spp=16, names=("depth",))["depth"]

    value, found = jax.jvp(jax.jit(depth), (0.0,), (1.0,))
    np.testing.assert_allclose(found, value / 5, rtol=0.01)


SCENE = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0.3, -6, 3" target="0, 0, 0.4" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="20"/>
        <string name="pixel_format" value="rgb"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="clay"><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf></bsdf>
<shape type="cube" id="a"><ref id="clay"/><transform name="to_world"><rotate z="1" angle="25"/></transform></shape>
<shape type="rectangle" id="b"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform></shape>
<emitter type="constant"/></scene>"""
AS_IN_MITSUBA = {
    "depth": ("d:depth", 1),
    "position": ("p:position", 3),
    "shading_normal": ("n:sh_normal", 3),
    "albedo": ("a:albedo", 3),
}


def test_as_in_mitsuba(tmp_path):
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        path = tmp_path / "scene.xml"
        path.write_text(SCENE)
        theirs = mi.load_file(str(path))
        integrator = mi.load_dict({"type": "aov", "aovs": ",".join(kind for kind, _ in AS_IN_MITSUBA.values())})
        image = np.asarray(mi.render(theirs, integrator=integrator, spp=256))
        sensor = theirs.sensors()[0]
        ids = np.empty((20, 24), object)
        for row, column in np.ndindex(20, 24):
            ray, _ = sensor.sample_ray(0.0, 0.5, [(column + 0.5) / 24, (row + 0.5) / 20], [0.5, 0.5])
            hit = theirs.ray_intersect(ray)
            ids[row, column] = hit.shape.id() if hit.is_valid() else None
    finally:
        if before is not None:
            mi.set_variant(before)
    scene = jd.load_mitsuba(path)
    found = {name: np.asarray(values) for name, values in jd.render_aovs(scene, KEY, spp=256).items()}
    first = 0
    for name, (_, channels) in AS_IN_MITSUBA.items():
        expected = image[..., first : first + channels]
        first += channels
        error = np.abs(found[name] - expected) / np.abs(expected).max()  # depth by 0.01 more: from the near plane
        assert error.mean() < 0.004 and np.quantile(error, 0.98) < 0.05, (name, error.mean(), error.max())
    names = np.array([*scene.shapes, None], object)
    assert np.mean(names[found["shape"]] == ids) > 0.99
