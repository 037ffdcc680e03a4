"""Parameters that stand for one number: of a scene, and as the ids of files say."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments.real_scenes.gltf_writer import CORNERS, CUBE, File
from jaxdr.scene.motion import motion
from tests.scene.conftest import SENSOR

A, B = "ball.bsdf.reflectance", "box.bsdf.reflectance"
CAMERA = jd.Perspective(jd.look_at((0, -6, 0), (0, 0, 0), (0, 0, 1)), 40.0, jd.Film(6, 4))
SCENE = jd.Scene(
    {
        "ball": jd.Shape(jd.shapes.sphere(0, center=(-1.2, 0, 0)), jd.Diffuse(0.5)),
        "box": jd.Shape(jd.shapes.box(center=(1.2, 0, 0)), jd.TwoSided(jd.Diffuse(0.5))),
        "rough": jd.Shape(jd.shapes.box(center=(0, 9, 0)), jd.RoughConductor(0.3)),
    },
    CAMERA,
    jd.ConstantEnvironment(1.0),
).tie({"grey.reflectance": (A, B)})
REF = '<ref id="m"/>'


def test_a_tie_sets_and_stands_for_all_its_parameters():
    assert {A, B} <= set(SCENE.parameters()) and "grey.reflectance" not in SCENE.parameters()
    tied = SCENE.parameters(tied=True)
    assert not {A, B} & set(tied) and set(SCENE.parameters()) - {A, B} == set(tied) - {"grey.reflectance"}
    new = SCENE.replace({"grey.reflectance": np.array([0.1, 0.2, 0.3])}).parameters()
    for name, old in SCENE.parameters().items():
        np.testing.assert_array_equal(new[name], np.float32([0.1, 0.2, 0.3]) if name in (A, B) else old)
    np.testing.assert_array_equal(SCENE.replace(tied).parameters()[B], SCENE.parameters()[B])


def test_the_derivative_by_a_tie_is_the_sum_of_those_of_its_parameters():
    def energy(values):
        """A function of the scene, as an image is one, that depends on both in different ways."""
        ball, box = (SCENE.replace(values).parameters()[name] for name in (A, B))
        return (jnp.exp(ball) * box**2).sum()

    gradient = jax.jit(jax.grad(energy))
    value = SCENE.parameters()[A]
    alone, together = gradient({A: value, B: value}), gradient({"grey.reflectance": value})
    assert float(alone[A].min()) > 0 and float(alone[B].min()) > 0
    np.testing.assert_allclose(together["grey.reflectance"], alone[A] + alone[B], rtol=1e-6)


def test_a_tie_may_be_a_motion():
    assert list(motion(SCENE, "grey.reflectance")) == ["grey.reflectance"]


def test_a_tie_holds_for_what_is_there():
    shapes = SCENE.shapes | {"third": SCENE.shapes["ball"]}
    three = dataclasses.replace(SCENE, shapes=shapes, tied=()).tie({"grey": (A, B, "third.bsdf.reflectance")})
    changed = dataclasses.replace(three, shapes=shapes | {"ball": jd.Shape(shapes["ball"].mesh, jd.Dielectric())})
    assert changed.replace({"grey": np.ones(3)}).parameters()[B].tolist() == [1, 1, 1]
    gone = dataclasses.replace(SCENE, shapes={"box": SCENE.shapes["box"]})
    assert gone.parameters(tied=True).keys() == gone.parameters().keys()
    with pytest.raises(ValueError, match=r"unknown parameter 'grey\.reflectance'"):
        gone.replace({"grey.reflectance": np.ones(3)})


def test_parameters_that_differ_are_not_one():
    apart = SCENE.replace({A: np.ones(3)})
    with pytest.raises(ValueError, match=rf"grey\.reflectance is one parameter, and {A} and {B} differ; give both"):
        apart.parameters(tied=True)
    with pytest.raises(ValueError, match="is not a motion or parameter"):
        motion(apart, "grey.reflectance")
    assert list(motion(apart, "ball.translate.x")) == ["ball.vertices"]
    both = apart.replace({"grey.reflectance": np.ones(3)})
    assert both.parameters(tied=True)["grey.reflectance"].tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    ("ties", "message"),
    [
        ({A: (A, B)}, "'ball.bsdf.reflectance' is taken or empty"),
        ({"grey.reflectance": ("ball.vertices", "box.vertices")}, "'grey.reflectance' is taken or empty"),
        ({"": (A, B)}, "'' is taken or empty"),
        ({"x": ("rough.bsdf.alpha",)}, "name two parameters or more"),
        ({"x": ("rough.bsdf.k", "bal.vertices")}, "unknown parameter 'bal.vertices'; this scene has: .*ball.vertices"),
        ({"x": (A, "rough.bsdf.k")}, f"{A} is tied by grey.reflectance already"),
        ({"x": ("rough.bsdf.k", "rough.bsdf.k")}, "rough.bsdf.k is tied by x already"),
        ({"x": ("rough.bsdf.k", "rough.bsdf.alpha")}, r"the shapes differ: rough.bsdf.k \(3,\), rough.bsdf.alpha \(\)"),
        ({"x": ("rough.bsdf.k", "rough.bsdf.eta")}, "rough.bsdf.k and rough.bsdf.eta differ; give both one value"),
    ],
)
def test_ties_that_are_none(ties, message):
    with pytest.raises(ValueError, match=message):
        SCENE.tie(ties)


def test_a_value_is_given_once():
    with pytest.raises(ValueError, match=r"box\.bsdf\.reflectance is given twice, by its name and by a tie"):
        SCENE.replace({B: np.ones(3), "grey.reflectance": np.ones(3)})


def shape(name, inside, kind="cube"):
    return f'<shape type="{kind}" id="{name}">{inside}</shape>'


def ties(scene):
    return dict(scene.tied)


def test_a_bsdf_that_shapes_share(load):
    scene = load(SENSOR + f'{shape("a", REF)}<bsdf type="roughplastic" id="m"/>{shape("b", REF)}{shape("c", "")}')
    fields = [name.removeprefix("a.bsdf.") for name in scene.parameters() if name.startswith("a.bsdf.")]
    assert ties(scene) == {f"m.{field}": (f"a.bsdf.{field}", f"b.bsdf.{field}") for field in sorted(fields)}
    assert "m.diffuse_reflectance" in scene.parameters(tied=True) and "c.bsdf.reflectance" in scene.parameters()


def test_what_is_not_shared_is_not_tied(load):
    scene = load(SENSOR + shape("a", '<bsdf type="diffuse" id="m"/>') + shape("b", '<bsdf type="diffuse" id="n"/>'))
    assert scene.tied == ()


def test_parts_that_bsdfs_share_are_named_by_the_innermost(load):
    """A BSDF inside of two masks; a texture of two BSDFs; an emitter."""
    scene = load(
        SENSOR
        + '<texture type="checkerboard" id="board"/><emitter type="area" id="glow"/>'
        + '<bsdf type="diffuse" id="m"><ref name="reflectance" id="board"/></bsdf>'
        + f'<bsdf type="mask" id="holes"><float name="opacity" value="0.5"/>{REF}</bsdf>'
        + shape("a", '<ref id="holes"/><ref id="glow"/>')
        + shape("b", f'<bsdf type="mask">{REF}</bsdf><ref id="glow"/>')
        + shape("c", '<ref id="holes"/>')
        + shape("d", '<bsdf type="plastic"><ref name="diffuse_reflectance" id="board"/></bsdf>')
    )
    inside = [f"{name}.bsdf.bsdf.reflectance" for name in "abc"] + ["d.bsdf.diffuse_reflectance"]
    assert ties(scene) == {
        "board.color0": tuple(f"{name}.color0" for name in inside),
        "board.color1": tuple(f"{name}.color1" for name in inside),
        "glow.radiance": ("a.emitter.radiance", "b.emitter.radiance"),
        "holes.opacity": ("a.bsdf.opacity", "c.bsdf.opacity"),
    }


def test_what_depends_on_the_mesh_is_not_tied(load, tmp_path):
    """Colours of vertices belong to each mesh; the rest of their BSDF is one."""
    for name, red in (("one", 0.1), ("two", 0.2)):
        rows = "".join(f"{x} {y} 0 {red} 0 0\n" for x, y in ((0, 0), (1, 0), (0, 1)))
        names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "r", "g", "b"))
        head = f"ply\nformat ascii 1.0\nelement vertex 3\n{names}element face 1\n"
        tail = "property list uchar int vertex_indices\nend_header\n"
        (tmp_path / f"{name}.ply").write_text(f"{head}{tail}{rows}3 0 1 2\n")
    texture = '<texture type="mesh_attribute" name="diffuse_reflectance"><string name="name" value="vertex_color"/>'
    scene = load(
        SENSOR
        + f'<bsdf type="roughplastic" id="m">{texture}</texture></bsdf>'
        + shape("a", f'<string name="filename" value="one.ply"/>{REF}', "ply")
        + shape("b", f'<string name="filename" value="two.ply"/>{REF}', "ply")
    )
    assert ties(scene)["m.alpha"] == ("a.bsdf.alpha", "b.bsdf.alpha")
    assert not any("diffuse_reflectance" in name for name in ties(scene))


def test_instances_share_the_bsdf_of_their_group(load):
    group = shape("g", shape("leaf", '<bsdf type="diffuse"/>'), "shapegroup")
    scene = load(SENSOR + group + shape("i", '<ref id="g"/>', "instance") + shape("j", '<ref id="g"/>', "instance"))
    assert ties(scene) == {"leaf.bsdf.reflectance": ("i.bsdf.reflectance", "j.bsdf.reflectance")}


@pytest.mark.parametrize(("name", "called"), [("brass", "brass"), ("a", "a_1")])
def test_materials_of_gltf(tmp_path, name, called):
    """Two cubes of one brass that glows, one that is of another. A name that is taken gets a number."""
    file = File()
    brass = {"name": name, "emissiveFactor": [1, 0.5, 0], "pbrMetallicRoughness": {"roughnessFactor": 0.3}}
    for material in (brass, {"pbrMetallicRoughness": {"roughnessFactor": 0.3}}):
        file.add("materials", material)
    attributes, indices = {"POSITION": file.accessor(CORNERS)}, file.accessor(CUBE.reshape(-1))
    for number, node in enumerate(("a", "b", "c")):
        primitive = {"attributes": attributes, "indices": indices, "material": number // 2}
        file.node(mesh=file.mesh(primitive), name=node)
    scene = jd.load_gltf(file.save(tmp_path / "a.glb"))
    found = ties(scene)
    assert found[f"{called}.bsdf.roughness"] == ("a.bsdf.roughness", "b.bsdf.roughness")
    assert found[f"{called}.emitter.radiance"] == ("a.emitter.radiance", "b.emitter.radiance")
    assert not any("c." in member for members in found.values() for member in members)
