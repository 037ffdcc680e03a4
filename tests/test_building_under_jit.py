"""Whatever is built of concrete values inside `jit` is the same as outside, and concrete."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxdr as jd
from tests.test_documentation import public_names
from tests.views.folders import write_nerf

RNG = np.random.default_rng(0)
PICTURE = RNG.random((5, 6, 3)).astype(np.float32)
POSE = jd.look_at((0, -4, 1), (0, 0, 0), (0, 0, 1))
MITSUBA = """<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/>
<integer name="height" value="8"/></film></sensor><emitter type="constant"/>
<shape type="sphere"><bsdf type="diffuse"><texture name="reflectance" type="checkerboard"/></bsdf></shape>
<shape type="obj"><string name="filename" value="m.obj"/>
<transform name="to_world"><rotate y="1" angle="20"/></transform><bsdf type="roughconductor"/></shape></scene>"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    jd.save_mesh(folder / "m.obj", jd.shapes.box())
    jd.save_mesh(folder / "m.glb", jd.shapes.box())
    (folder / "scene.xml").write_text(MITSUBA)
    jd.write_image(folder / "picture.png", PICTURE)
    write_nerf(folder / "photographs")
    camera = jd.Perspective(POSE, 40.0, jd.Film(8, 8))
    ball = jd.shapes.sphere(0)
    scene = jd.Scene({"ball": jd.Shape(ball)}, camera)
    return SimpleNamespace(folder=folder, camera=camera, ball=ball, scene=scene)


def scene(of):
    board = jd.Shape(jd.shapes.rectangle(), jd.Diffuse(jd.Bitmap(PICTURE)), jd.AreaEmitter(2.0))
    shapes = {"ball": jd.Shape(jd.shapes.sphere(0).smooth()), "board": board}
    return jd.Scene(shapes, of.camera, jd.ConstantEnvironment(0.5), {"sun": jd.DirectionalLight((0, 0, -1))})


# Public name -> what is made of concrete values.
BUILT = {
    "AreaEmitter": lambda of: jd.AreaEmitter((1.0, 2, 3)),
    "Bitmap": lambda of: [jd.Bitmap(PICTURE, to_uv=np.eye(3)), jd.Bitmap(PICTURE[..., 0]).times(2.0)],
    "Blend": lambda of: jd.Blend(0.3, jd.Diffuse(0.2), jd.Plastic(0.5)),
    "BumpMap": lambda of: jd.BumpMap(jd.Bitmap(PICTURE[..., 0]), jd.Diffuse()),
    "Checkerboard": lambda of: jd.Checkerboard(0.2, (0.1, 0.2, 0.3), to_uv=2 * np.eye(3)[:2]),
    "Conductor": lambda of: [jd.Conductor("Au"), jd.Conductor()],
    "ConstantEnvironment": lambda of: jd.ConstantEnvironment((1, 2, 3)),
    "Dielectric": lambda of: jd.Dielectric("bk7"),
    "Diffuse": lambda of: [jd.Diffuse(), jd.Diffuse(np.array([0.1, 0.2, 0.3])), jd.Diffuse(jd.Bitmap(PICTURE))],
    "DirectionalLight": lambda of: jd.DirectionalLight((0, 0, -1), 2.0),
    "EnvironmentMap": lambda of: jd.EnvironmentMap(PICTURE, np.eye(4), 2.0),
    "FaceColors": lambda of: jd.FaceColors(PICTURE[0]),
    "LargeSteps": lambda of: jd.LargeSteps(jd.shapes.sphere(0), 3.0),
    "Mask": lambda of: jd.Mask(0.5, jd.Diffuse()),
    "Mesh": lambda of: jd.Mesh(np.eye(4)[:, :3], np.array([[0, 1, 2], [0, 2, 3]]), np.eye(4)[:, :2], [[0, 1, 2]] * 2),
    "NormalMap": lambda of: jd.NormalMap(jd.Bitmap(PICTURE), jd.Diffuse()),
    "Orthographic": lambda of: jd.Orthographic(POSE, jd.Film(8, 8)),
    "Perspective": lambda of: jd.Perspective(POSE, 40.0, jd.Film(8, 8)),
    "Phong": lambda of: jd.Phong(0.3, 0.2, 20.0),
    "Plastic": lambda of: jd.Plastic((0.1, 0.2, 0.3)),
    "PointLight": lambda of: jd.PointLight((0, 1, 2), 3.0),
    "Principled": lambda of: jd.Principled((0.1, 0.2, 0.3), metallic=jd.Bitmap(PICTURE[..., 0])),
    "Product": lambda of: jd.Product(jd.Bitmap(PICTURE), jd.Checkerboard(0.2, 0.4)).times(0.5),
    "Projector": lambda of: jd.Projector(PICTURE, POSE, 40.0),
    "RoughConductor": lambda of: jd.RoughConductor(0.2, material="Cu"),
    "RoughDielectric": lambda of: jd.RoughDielectric(0.2, "bk7", "air"),
    "RoughPlastic": lambda of: jd.RoughPlastic((0.1, 0.2, 0.3), 0.2),
    "Scene": lambda of: [scene(of), scene(of).replace({"ball.bsdf.reflectance": np.ones(3)}).parameters()],
    "Shape": lambda of: jd.Shape(jd.shapes.box(), jd.TwoSided(jd.Diffuse())),
    "SpotLight": lambda of: jd.SpotLight((0, 0, 1), (0, 1, 0)),
    "TexturedSpotLight": lambda of: jd.TexturedSpotLight((0, 0, 1), (0, 1, 0), PICTURE, (0, 0, 1)),
    "ThinDielectric": lambda of: jd.ThinDielectric(1.5),
    "ThinLens": lambda of: jd.ThinLens(POSE, 40.0, jd.Film(8, 8), aperture_radius=0.1, focus_distance=3.0),
    "TwoSided": lambda of: jd.TwoSided(jd.Diffuse()),
    "VertexColors": lambda of: jd.VertexColors(PICTURE[0, :, 0]),
    "load_gltf": lambda of: jd.load_gltf(of.folder / "m.glb"),
    "load_image": lambda of: jd.load_image(of.folder / "picture.png"),
    "load_mesh": lambda of: [jd.load_mesh(of.folder / name, shading="smooth") for name in ("m.obj", "m.glb")],
    "load_mitsuba": lambda of: jd.load_mitsuba(of.folder / "scene.xml"),
    "load_shape": lambda of: jd.load_shape(of.folder / "m.obj"),
    "load_views": lambda of: jd.load_views(of.folder / "photographs").views[0].image,
    "look_at": lambda of: jd.look_at((0, -4, 1), np.zeros(3), (0, 0, 1)),
    "move": lambda of: jd.move(scene(of), {"ball.translate": (1, 0, 2), "ball.scale.x": 2.0, "camera.rotate.z": 0.1}),
    "remesh": lambda of: jd.remesh(jd.shapes.sphere(1), 0.5, iterations=1),
    "shapes": lambda of: [
        jd.shapes.sphere(0, 2.0, (1, 2, 3)),
        jd.shapes.displaced_sphere(1),
        jd.shapes.box((1, 2, 3)),
        jd.shapes.rectangle(),
        jd.shapes.plane(2.0, 3),
        jd.shapes.torus(major_segments=5, minor_segments=4),
        jd.shapes.trefoil_tube(segments=16, sides=4),
        jd.shapes.revolved([[0, 0], [1, 0], [0, 1]], 6),
        jd.shapes.pawn(8),
        jd.shapes.duck(2),
        jd.shapes.star(),
        jd.shapes.transformed(jd.shapes.box().smooth(), np.diag([-1.0, 2, 3, 1])),
        jd.shapes.centred(jd.shapes.box(), 3.0),
        jd.shapes.box().with_vertices(np.ones((8, 3))).flat(),
        jd.shapes.box().with_uvs(np.eye(4)[:, :2], np.tile([[0, 1, 2]], (12, 1))),
        jd.shapes.box().turned(),
    ],
    "remesh_field_aligned": lambda of: None,  # its package is not everywhere; it builds a `Mesh`
}
# Settings without arrays, base classes, and what renders, fits, measures or writes.
NOT_BUILT = """
    AllSilhouettes Answers BSDF BidirectionalPathTracer Box ByKind Chunk Context DeltaBSDF DeltaLight Environment
    EstimatorWarning Film Gaussian GuidedEdges KernelDensity LineSampling MarkovChains Moving PathTracer Picture Plan
    QuadricSampling RednerWAS Requests ReusedGuides Tent Term Texture View Views WalkOnCaps WarpedArea adam_uniform
    build_guides chamfer derivative_terms evaluate_views guide_report jit losses plan refit_guides render
    render_aovs render_views save_gltf save_mesh working write_image
"""


def test_every_public_name_is_in_the_table():
    assert sorted(public_names()) == sorted([*BUILT, *NOT_BUILT.split()])


def test_every_shape_is_in_the_table():
    made = BUILT["shapes"].__code__.co_consts, BUILT["shapes"].__code__.co_names
    functions = [name for name, f in vars(jd.shapes).items() if getattr(f, "__module__", "") == jd.shapes.__name__]
    assert [
        name for name in functions if not name.startswith("_") and name not in (*made[1], "transformed_arrays")
    ] == []


@pytest.mark.parametrize("name", BUILT)
def test_the_same_as_outside(name, files):
    expected = jax.tree.leaves(BUILT[name](files))
    found = []

    def traced(t):
        found.extend(jax.tree.leaves(BUILT[name](files)))
        return t

    jax.eval_shape(jax.jit(traced), 0.5)
    assert not any(isinstance(leaf, jax.core.Tracer) for leaf in found)
    assert len(found) == len(expected)
    for one, two in zip(found, expected, strict=True):
        assert np.asarray(one).dtype == np.asarray(two).dtype
        np.testing.assert_array_equal(np.asarray(one), np.asarray(two))


def test_values_are_checked_inside_of_jit():
    with pytest.raises(ValueError, match="Diffuse: reflectance must be at least"):
        jax.eval_shape(lambda t: jd.Diffuse(-2.0).reflectance * t, 0.5)


def test_arrays_of_scenes_that_are_made_in_jit_can_be_used():
    """As constants of the program, and in every transformation around it."""

    def f(t):
        return (jd.shapes.sphere(0).vertices ** 2 * t).sum() * jd.Diffuse(0.5).reflectance.sum()

    assert float(jax.jit(f)(0.5)) == pytest.approx(9.0)
    assert float(jax.jit(jax.grad(f))(0.5)) == pytest.approx(18.0)
    np.testing.assert_allclose(jax.jit(jax.vmap(f))(jnp.array([0.5, 1.0])), [9.0, 18.0], rtol=1e-5)


# Cameras and maps that are traced


VECTORS = (jnp.array([0.5, -4.0, 1.0]), jnp.array([0.1, 0.2, 0.3]), jnp.array([0.1, 0.0, 1.0]))


def test_a_traced_look_at():
    expected = jd.look_at(*VECTORS)
    assert isinstance(expected, np.ndarray)
    np.testing.assert_allclose(jax.jit(jd.look_at)(*VECTORS), expected, atol=1e-6)
    with jax.enable_x64(True):
        check_grads(jd.look_at, [jnp.asarray(v, float) for v in VECTORS], 1, ("fwd", "rev"), 1e-5, 1e-5)


def test_a_camera_whose_origin_is_a_list_with_a_traced_number():
    def position(x):
        camera = jd.Perspective(jd.look_at([x, -4.0, 1.0], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 8))
        return camera.project(jnp.array([0.3, 0.2, 0.1]))

    found, slope = jax.jit(lambda x: jax.jvp(position, (x,), (1.0,)))(0.5)
    np.testing.assert_allclose(found, position(0.5), rtol=1e-5)
    np.testing.assert_allclose(slope, (position(0.51) - position(0.49)) / 0.02, rtol=1e-3, atol=1e-3)
    assert (np.abs(slope) > 0.05).all()


def test_a_pose_that_is_a_list_with_a_traced_number():
    def camera(x):
        return jd.Perspective([[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], x, jd.Film(8, 8)).position

    np.testing.assert_array_equal(jax.jit(camera)(2.0), [2, 0, 0])


def test_traced_vectors_without_a_direction_show():
    """Nobody can raise for traced values: the matrix must not look like one."""
    assert np.isnan(jax.jit(jd.look_at)(jnp.zeros(3), jnp.zeros(3), jnp.array([0.0, 0, 1]))).any()
    assert np.isnan(jax.jit(jd.look_at)(jnp.zeros(3), jnp.array([0.0, 0, 2]), jnp.array([0.0, 0, 1]))).any()
    with pytest.raises(ValueError, match="look_at: up"):
        jax.eval_shape(lambda t: jd.look_at((0, 0, 0), (0, 0, 1), (0, 0, 2)) * t, 0.5)


MESHES = {
    "open": lambda: jd.shapes.rectangle().smooth(),
    "closed": lambda: jd.shapes.box().smooth(),
    "three faces at an edge": lambda: jd.Mesh(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -1, 0]], [[0, 1, 2], [1, 0, 3], [0, 1, 4]]
    ),
}
MAPS = {"turns": POSE + 0.1 * np.eye(4, k=1)[[0, 1, 2, 0]] * [[1], [1], [1], [0]], "mirrors": np.diag([-2.0, 1, 1, 1])}


def edges_of(mesh):
    """Its edges as they depend on the order of nothing: ends, and for each face its opposite vertex."""
    rows = zip(
        *(np.asarray(x).tolist() for x in (mesh.edges.vertices, mesh.edges.faces, mesh.edges.opposite)), strict=True
    )
    return sorted((sorted(ends), sorted(zip(faces, opposite, strict=True))) for ends, faces, opposite in rows)


@pytest.mark.parametrize("which", ["mesh", "matrix", "both", "vertices"])
@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("name", MAPS)
def test_a_traced_transformation(name, mesh, which):
    mesh, matrix = MESHES[mesh](), MAPS[name]
    expected = jd.shapes.transformed(mesh, matrix)

    calls = {
        "mesh": lambda: jax.jit(lambda m: jd.shapes.transformed(m, matrix))(mesh),
        "matrix": lambda: jax.jit(lambda x: jd.shapes.transformed(mesh, x))(matrix),
        "both": lambda: jax.jit(jd.shapes.transformed)(mesh, matrix),
        "vertices": lambda: jax.jit(lambda v: jd.shapes.transformed(mesh.with_vertices(v), matrix))(mesh.vertices),
    }
    found = calls[which]()
    np.testing.assert_allclose(found.vertices, expected.vertices, atol=1e-6)
    for field in ("faces", "uv_faces", "normal_faces", "uvs"):
        one, two = getattr(found, field), getattr(expected, field)
        assert (one is None) == (two is None)
        if one is not None:
            np.testing.assert_array_equal(one, two)
    assert edges_of(found) == edges_of(expected)
    # Face 0 of an edge runs through it from its first end to its second, face 1 of an interior edge the other way.
    faces, edges = np.asarray(found.faces), jax.tree.map(np.asarray, found.edges)
    for (start, end), (one, two), kind in zip(edges.vertices, edges.faces[:, :2], edges.kind, strict=True):
        steps = [list(zip(faces[f], np.roll(faces[f], -1), strict=True)) for f in (one, two)]
        assert (start, end) in steps[0]
        assert kind != 0 or (end, start) in steps[1]


def test_derivatives_of_a_traced_transformation():
    with jax.enable_x64(True):
        mesh = jd.shapes.sphere(0)

        def along(top):
            return jd.shapes.transformed(mesh, jnp.concatenate([top, jnp.array([[0.0, 0, 0, 1]])])).vertices

        check_grads(jax.jit(along), [jnp.asarray(POSE[:3])], 1, ("fwd", "rev"), 1e-5, 1e-5)

        def moved(v):
            return jd.shapes.centred(jd.shapes.transformed(mesh.with_vertices(v), POSE), 3.0).vertices

        bent = mesh.vertices * jnp.array([1.0, 1.1, 1.3])
        check_grads(jax.jit(moved), [bent], 1, ("fwd", "rev"), 1e-5, 1e-5)
        np.testing.assert_allclose(jax.jit(moved)(bent), moved(bent), atol=1e-12)


def test_a_matrix_of_another_shape_is_refused_when_traced():
    with pytest.raises(ValueError, match="matrix must have shape"):
        jax.eval_shape(lambda m: jd.shapes.transformed(jd.shapes.box(), m), jnp.eye(3))
    with pytest.raises(ValueError, match="matrix has no inverse"):
        jax.eval_shape(lambda m: jd.shapes.transformed(m, np.diag([0.0, 1, 1, 1])), jd.shapes.box())


@pytest.mark.parametrize("name", ["vertices", "faces", "uvs", "uv_faces", "normal_faces"])
def test_meshes_of_traced_arrays_are_refused(name):
    triangle = [[0, 1, 2]]
    arrays = {"vertices": np.eye(3), "faces": triangle, "uvs": np.eye(3)[:, :2], "uv_faces": triangle}
    arrays = {key: jnp.asarray(value) for key, value in (arrays | {"normal_faces": triangle}).items()}
    with pytest.raises(ValueError, match=f"Mesh: needs concrete {name}"):
        jax.eval_shape(lambda x: jd.Mesh(**(arrays | {name: x})), arrays[name])
