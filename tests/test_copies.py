"""Every public object can be pickled and copied: for other processes, and for files of one's own."""

import copy
import inspect
import pickle
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.guided_edges.reused_guides import build_guides
from jaxdr.scene.packed import pack
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form
from tests.views.folders import write_nerf

BALL = jd.shapes.sphere(0)
POSE = jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1))
FILM = jd.Film(4, 4, jd.Gaussian(0.5))
SETTINGS = PathSettings(2, True, "auto")
PICTURE = np.random.default_rng(0).random((3, 4, 3), np.float32)


def scene() -> jd.Scene:
    """A scene with a mesh lamp, a light, a sky and a texture."""
    plate = jd.shapes.rectangle()
    return jd.Scene(
        {
            "ball": jd.Shape(BALL, jd.TwoSided(jd.Principled(0.4))),
            "plate": jd.Shape(plate, jd.Diffuse(jd.Bitmap(PICTURE)), jd.AreaEmitter(2.0)),
        },
        jd.Perspective(POSE, 30.0, FILM),
        jd.EnvironmentMap(PICTURE),
        {"point": jd.PointLight((0, 1, 2))},
    )


def small() -> jd.Scene:
    """A scene whose programs are small."""
    return jd.Scene({"ball": jd.Shape(BALL)}, jd.Perspective(POSE, 30.0, FILM), jd.ConstantEnvironment(1.0))


def views(folder: Path) -> jd.Views:
    """Photographs of a folder, of which one has been read."""
    found = jd.load_views(write_nerf(folder / "photographs"))
    assert found.views[0].image.size
    return found


MADE = {
    "AllSilhouettes": jd.AllSilhouettes,
    "Answers": lambda: jd.Answers(jnp.ones((1, 3)), jnp.zeros((1, 3))),
    "AreaEmitter": lambda: jd.AreaEmitter(jd.VertexColors(np.ones((12, 3)))),
    "BidirectionalPathTracer": jd.BidirectionalPathTracer,
    "Bitmap": lambda: jd.Bitmap(PICTURE, wrap="mirror"),
    "Blend": lambda: jd.Blend(0.5, jd.Diffuse(0.1), jd.RoughPlastic(0.3)),
    "Box": jd.Box,
    "BumpMap": lambda: jd.BumpMap(jd.Bitmap(PICTURE[..., 0]), jd.Diffuse(0.5)),
    "Chunk": lambda: jd.Chunk(jnp.arange(2), jnp.ones(2), None, None, jax.random.key(1)),
    "Checkerboard": lambda: jd.Checkerboard(0.1, 0.8),
    "Conductor": lambda: jd.Conductor(material="Au"),
    "ConstantEnvironment": lambda: jd.ConstantEnvironment(1.0),
    "ByKind": jd.ByKind,
    "Context": lambda: jd.Context(jax.jit(pack)(small()), jd.Moving((True,), False), SETTINGS, Form.FIXED, 1.0),
    "Dielectric": jd.Dielectric,
    "Diffuse": jd.Diffuse,
    "DirectionalLight": lambda: jd.DirectionalLight((0, 0, 1)),
    "EnvironmentMap": lambda: jd.EnvironmentMap(PICTURE),
    "EstimatorWarning": lambda: jd.EstimatorWarning("words"),
    "FaceColors": lambda: jd.FaceColors(np.ones((20, 3))),
    "Film": lambda: FILM,
    "Gaussian": lambda: jd.Gaussian(0.7),
    "GuidedEdges": jd.GuidedEdges,
    "KernelDensity": jd.KernelDensity,
    "LargeSteps": lambda: jd.LargeSteps(BALL, 5.0),
    "LineSampling": jd.LineSampling,
    "MarkovChains": jd.MarkovChains,
    "Mask": lambda: jd.Mask(0.5, jd.Diffuse(0.5)),
    "Mesh": lambda: BALL.smooth(),
    "Moving": lambda: jd.Moving((True, False), True),
    "NormalMap": lambda: jd.NormalMap(jd.Bitmap(PICTURE), jd.Diffuse(0.5)),
    "Orthographic": lambda: jd.Orthographic(POSE, FILM),
    "PathTracer": lambda: jd.PathTracer(max_depth=2, boundary=jd.LineSampling()),
    "Perspective": lambda: jd.Perspective(POSE, 30.0, FILM),
    "Phong": jd.Phong,
    "Picture": lambda: jd.Picture(PICTURE, "title"),
    "Plan": lambda: jd.Plan(jd.PathTracer(max_depth=2), 4, ("words",), {"spp": 4}),
    "Plastic": jd.Plastic,
    "PointLight": lambda: jd.PointLight((0, 1, 2)),
    "Principled": jd.Principled,
    "Product": lambda: jd.Product(jd.Bitmap(PICTURE), jd.VertexColors(np.ones((12, 3)))),
    "Projector": lambda: jd.Projector(PICTURE, POSE, 30.0),
    "QuadricSampling": jd.QuadricSampling,
    "RednerWAS": jd.RednerWAS,
    "ReusedGuides": lambda: build_guides(small(), jd.GuidedEdges(guide="none")),
    "Requests": lambda: jd.Requests(*(jnp.full(2, i) for i in range(8))),
    "RoughConductor": lambda: jd.RoughConductor(0.2, material="Au"),
    "RoughDielectric": lambda: jd.RoughDielectric(0.2),
    "RoughPlastic": lambda: jd.RoughPlastic(0.2),
    "Scene": scene,
    "Shape": lambda: jd.Shape(BALL),
    "SpotLight": lambda: jd.SpotLight((0, 0, 1), (0, 1, 0)),
    "Tent": jd.Tent,
    "TexturedSpotLight": lambda: jd.TexturedSpotLight((0, 0, 1), (0, 1, 0), PICTURE, (0, 0, 1)),
    "ThinDielectric": jd.ThinDielectric,
    "ThinLens": lambda: jd.ThinLens(POSE, 30.0, FILM, aperture_radius=0.1, focus_distance=2.0),
    "TwoSided": lambda: jd.TwoSided(jd.Diffuse(0.5)),
    "VertexColors": lambda: jd.VertexColors(np.ones((12, 3))),
    "View": lambda folder: views(folder).views[0],
    "Views": views,
    "WalkOnCaps": jd.WalkOnCaps,
    "WarpedArea": jd.WarpedArea,
    "adam_uniform": lambda: jd.adam_uniform(0.1).init(
        {"v": jnp.ones(3)}
    ),  # its state; optax's pairs of closures are not for files
}
ABSTRACT = {"BSDF", "DeltaBSDF", "DeltaLight", "Environment", "Term", "Texture"}
WAYS = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy, "copy": copy.copy}


def test_no_public_class_is_left_out():
    public = {name for name in dir(jd) if not name.startswith("_") and inspect.isclass(getattr(jd, name))}
    assert public - ABSTRACT <= set(MADE)
    assert all(inspect.isabstract(getattr(jd, name)) or name == "Term" for name in ABSTRACT)


def contents(value) -> list:
    """All that an object holds: arrays as bytes, and what can be compared."""
    if isinstance(value, jd.Views):
        return [contents(view) for view in value.views]
    if isinstance(value, jd.View):
        return [value.name, value.path, value.to_world.tobytes(), value.image.tobytes(), value.alpha.tobytes()]
    if isinstance(value, Warning):
        return [value.args]
    if isinstance(value, jd.Picture):
        return [value.pixels.tobytes()]
    leaves, structure = jax.tree.flatten(value)
    keys = [
        jax.random.key_data(x) if isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x
        for x in leaves
    ]
    found = [(x.dtype, x.shape, np.asarray(x).tobytes()) if isinstance(x, jax.Array) else x for x in keys]
    return found if isinstance(value, jd.LargeSteps) else [structure, *found]  # its factors compare by identity


@pytest.mark.parametrize("name", MADE)
def test_copies_hold_the_same(name, tmp_path):
    value = MADE[name](tmp_path) if inspect.signature(MADE[name]).parameters.keys() == {"folder"} else MADE[name]()
    for way, make in WAYS.items():
        other = make(value)
        assert type(other) is type(value) and contents(other) == contents(value), way


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_large_steps_solves_the_same_bit_for_bit(way):
    steps = jd.LargeSteps(BALL, 19.0)
    other = WAYS[way](steps)
    latent = steps.to_latent(BALL.vertices)
    np.testing.assert_array_equal(other.to_latent(BALL.vertices), latent)
    np.testing.assert_array_equal(other.from_latent(latent), steps.from_latent(latent))


def test_a_copy_of_a_scene_looks_the_same_bit_for_bit():
    first = small()
    draw = jax.jit(lambda scene: jd.render(scene, jax.random.key(0), spp=1, integrator=jd.PathTracer(1, None)))
    np.testing.assert_array_equal(draw(WAYS["pickle"](first)), draw(first))


def test_photographs_go_into_a_pickle_by_name_only(tmp_path):
    found = views(tmp_path)
    kept = WAYS["pickle"](found).views[0].picture.kept
    assert kept.limit == found.views[0].picture.kept.limit and kept.bytes == 0
    assert WAYS["deepcopy"](found).views[0].picture.kept is found.views[0].picture.kept
