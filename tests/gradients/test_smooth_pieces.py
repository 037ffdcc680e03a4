"""Every smooth piece of the measurement contribution against finite differences: float64, both modes, second order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxdr as jd
from jaxdr.geometry.shapes import sphere
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import intersect, material_point, on_fixed_ray
from jaxdr.transport.shading import Scatterer


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def check(function, *arguments):
    check_grads(jax.jit(function), arguments, order=1, modes=("fwd", "rev"), atol=1e-6, rtol=1e-6, eps=1e-5)


def bumpy_scene(smooth: bool) -> jd.Scene:
    """A slightly displaced sphere above a floor."""
    ball = sphere(1)
    vertices = np.asarray(ball.vertices, float)
    vertices = vertices + 0.1 * np.random.default_rng(5).standard_normal(vertices.shape)
    ball = jd.Mesh(vertices, ball.faces)
    return jd.Scene(
        shapes={"ball": jd.Shape(ball.smooth() if smooth else ball, jd.TwoSided(jd.Diffuse((0.2, 0.5, 0.7))))},
        camera=jd.Perspective(jd.look_at([1, -4, 2], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 8)),
    )


def hit_faces(scene, film_points):
    origin, directions = scene.camera.rays(film_points)
    origins = jnp.broadcast_to(origin, directions.shape)
    faces = intersect(pack(scene), origins, directions, jnp.ones(len(directions), bool), "warp").face
    return faces[faces >= 0][:6], film_points[faces >= 0][:6]


@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
def test_hit_on_a_fixed_camera_ray(smooth):
    scene = bumpy_scene(smooth)
    faces, film_points = hit_faces(scene, jnp.asarray(np.random.default_rng(6).uniform(2, 6, (20, 2))))
    assert len(faces) == 6

    def hit(vertices, to_world, fov):
        moved = scene.replace({"ball.vertices": vertices, "camera.to_world": to_world, "camera.fov": fov})
        origin, directions = moved.camera.rays(film_points)
        point = on_fixed_ray(pack(moved), jnp.broadcast_to(origin, directions.shape), directions, faces)
        return point.position, point.normal, point.shading_normal

    parameters = scene.parameters()
    check(hit, parameters["ball.vertices"], parameters["camera.to_world"], parameters["camera.fov"])


@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
def test_material_point_and_its_jacobian(smooth):
    scene = bumpy_scene(smooth)
    barycentric = jnp.asarray(np.random.default_rng(7).dirichlet([1, 1, 1], 5))
    faces = jnp.arange(5)

    def point(vertices):
        p = material_point(pack(scene.replace({"ball.vertices": vertices})), faces, barycentric, faces >= 0)
        return p.position, p.normal, p.shading_normal, p.area

    check(point, scene.parameters()["ball.vertices"])


def test_camera_projection_inverts_its_rays():
    camera = jd.Perspective(jd.look_at([1, -4, 2], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 6), fov_axis="diagonal")
    film_points = jnp.asarray(np.random.default_rng(6).uniform(0, 6, (5, 2)))
    origin, directions = camera.rays(film_points)
    np.testing.assert_allclose(camera.project(origin + 3.0 * directions), film_points, atol=1e-12)

    def project(points, to_world, fov):
        return jd.Perspective(to_world, fov, camera.film, fov_axis="diagonal").project(points)

    check(project, origin + 3.0 * directions, camera.to_world, camera.fov)


def test_vertex_normals():
    mesh = bumpy_scene(True).shapes["ball"].mesh
    check(lambda v: mesh.with_vertices(v).vertex_normals(), mesh.vertices)


def test_measurement_of_one_bounce():
    """BSDF times geometric term times area Jacobian of a segment between two material points."""
    scene = bumpy_scene(True)
    corners = jnp.asarray([[1 / 3, 1 / 3, 1 / 3]])
    eye = jnp.asarray([[1.0, -4.0, 2.0]])

    def contribution(vertices, reflectance):
        packed = pack(scene.replace({"ball.vertices": vertices, "ball.bsdf.reflectance": reflectance}))
        valid = jnp.ones(1, bool)
        x, y = (material_point(packed, jnp.asarray([f]), corners, valid) for f in (0, 7))
        between = y.position - x.position
        squared = (between**2).sum(-1)
        direction = between / jnp.sqrt(squared)[:, None]
        back = (eye - x.position) / jnp.linalg.norm(eye - x.position)
        cosine = jnp.abs((y.normal * direction).sum(-1))
        return Scatterer(packed, x, back).eval(direction) * (cosine / squared * x.area * y.area)[:, None]

    parameters = scene.parameters()
    check(contribution, parameters["ball.vertices"], parameters["ball.bsdf.reflectance"])
