"""Shapes around the object, materials, and an object that turns before a fixed camera."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.optimize.config import Cameras, Floor, Integrator, OptimizeConfig, Target, Turntable
from jaxdr.optimize.phase import view_renderer
from jaxdr.optimize.problem import build_problem
from jaxdr.optimize.surroundings import FixedShape, material_of


def test_a_mirror_faces_its_target():
    made = FixedShape(
        shape="rectangle",
        parameters={"width": 2.0, "height": 1.0},
        position=(0.0, 0.0, -1.0),
        target=(3.0, 0.0, -1.0),
        material={"kind": "RoughConductor", "alpha": 0.1},
    ).build()
    a, b, c = np.asarray(made.mesh.vertices)[np.asarray(made.mesh.faces)[0]]
    normal = np.cross(b - a, c - a)
    np.testing.assert_allclose(normal / np.linalg.norm(normal), [1, 0, 0], atol=1e-6)
    assert isinstance(made.bsdf, jd.TwoSided) and isinstance(made.bsdf.bsdf, jd.RoughConductor)


def test_size_and_place():
    mesh = FixedShape(shape="box", parameters={"size": [1, 2, 4]}, size=2.0, position=(1.0, 2.0, 3.0)).mesh()
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.5, 1.0, 2.0], rtol=1e-6)
    np.testing.assert_allclose(np.mean(mesh.vertices, axis=0), [1, 2, 3], rtol=1e-6)


def test_glass_has_two_sides_of_its_own():
    assert isinstance(material_of({"kind": "RoughDielectric", "alpha": 0.2}), jd.RoughDielectric)
    assert isinstance(material_of({}, 0.25), jd.TwoSided)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "shape: give either a shape or a path"),
        ({"shape": "bok"}, "shape: expected one of rectangle"),
        ({"shape": "box", "parameters": {"sise": 1}}, "parameters.sise: box has no such parameter"),
        ({"shape": "box", "size": 0.0}, "size: must be positive"),
        ({"shape": "box", "material": {"kind": "Gold"}}, "material.kind: expected one of Diffuse"),
        ({"shape": "box", "material": {"kind": "Diffuse", "alpha": 1}}, "material.alpha: Diffuse has no such option"),
        ({"shape": "box", "material": {"kind": "RoughConductor", "alpha": -1}}, "material: RoughConductor"),
        ({"shape": "box", "target": (0.0, 0.0, 0.0)}, "position: must differ from target"),
    ],
)
def test_mistakes_name_the_key(options, words):
    with pytest.raises(ValueError) as problem:
        FixedShape(**options)
    assert words in str(problem.value)


def test_bidirectional_paths_take_what_they_know():
    assert isinstance(Integrator(kind="bdpt", boundary="WarpedArea").build(), jd.BidirectionalPathTracer)
    for options, words in (
        ({"boundary": "LineSampling"}, "boundary: BidirectionalPathTracer"),
        ({"primary": "material"}, 'primary: must be .fixed_ray. with kind "bdpt"'),
        ({"boundary": "plan"}, 'kind: must be "path" with max_depth or boundary "plan"'),
    ):
        with pytest.raises(ValueError, match=words):
            Integrator(kind="bdpt", **options)


def test_a_turning_object_looks_as_it_does_to_cameras_around_it():
    """Alone under a constant sky: a camera at -y sees of the turned object what the camera that goes round sees."""
    options = {
        "output": "x",
        "target": Target(shape="duck", parameters={"subdivisions": 2}),
        "cameras": Cameras(views=4, resolution=12, distance=3.0, fov=30.0, elevation=(-40.0, 60.0)),
        "lights": (),
        "environment": 0.5,
    }
    images = []
    for more in ({}, {"turntable": Turntable(position=(0.0, -3.0, 0.0))}):
        config = OptimizeConfig(**options, **more, integrator=Integrator(boundary="none"))
        problem = build_problem(config)
        image = jax.jit(view_renderer(problem, 12), static_argnums=3)
        images.append([np.asarray(image(problem.target, pose, jax.random.key(0), 64)) for pose in problem.views])
    for one, two in zip(*images, strict=True):
        assert one.std() > 0.05
        np.testing.assert_allclose(one, two, atol=0.02)


def test_scene_has_the_shapes_and_says_which_is_wrong():
    shapes = (FixedShape(shape="box"), FixedShape(shape="sphere", parameters={"subdivisions": 1}))
    config = OptimizeConfig(output="x", target=Target(shape="box"), floor=Floor(), shapes=shapes)
    assert {"shape_0", "shape_1"} <= set(build_problem(config).scene.shapes)
    wrong = (FixedShape(shape="sphere", parameters={"subdivisions": -1}),)
    with pytest.raises(ValueError, match=r"shapes\.0: "):
        build_problem(OptimizeConfig(output="x", target=Target(shape="box"), shapes=wrong))
