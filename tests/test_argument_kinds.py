"""No public constructor or function takes an argument of the wrong kind, or fails for it in words of its own inside."""

import inspect
import json
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float, jaxtyped

import jaxdr as jd
from jaxdr.argument_kinds import checked, made_of_numbers, shown
from tests import wrong_arguments
from tests.test_documentation import public_names

ROOT = Path(__file__).resolve().parents[1]
# What holds results and state, which the library fills, base classes, and modules, whose functions are in the table.
NOT_CALLED = """
    Answers BSDF Chunk Context DeltaBSDF DeltaLight Environment EstimatorWarning Moving Plan Requests ReusedGuides Term
    Texture View Views losses shapes
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """(name, parameter, kind of the value, what happened) where there was no clear refusal, and the output."""
    run = [sys.executable, str(ROOT / "tests/wrong_arguments.py")]
    settings = os.environ | {"PYTHONPATH": str(ROOT)}
    folder = tmp_path_factory.mktemp("empty")
    done = subprocess.run(run, capture_output=True, text=True, cwd=folder, env=settings, timeout=300)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]


def test_every_public_name_is_in_the_table():
    named = {name for name in wrong_arguments.VALID if "." not in name}
    assert sorted(public_names()) == sorted([*named, *NOT_CALLED.split()])
    for module in (jd.shapes, jd.losses):
        short = module.__name__.rpartition(".")[2]
        own = [name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        public = {f"{short}.{name}" for name in own if not name.startswith("_")} - {"shapes.transformed_arrays"}
        assert public == {name for name in wrong_arguments.VALID if name.startswith(f"{short}.")}


@pytest.mark.parametrize("name", wrong_arguments.VALID)
def test_wrong_kinds_are_refused_in_one_line(name, outcomes):
    assert [rest for owner, *rest in outcomes if owner == name] == []


def test_a_refusal_is_a_line_with_function_parameter_kind_and_value():
    with pytest.raises(ValueError, match=r"^sphere: radius must be a number, got 'wide'$"):
        jd.shapes.sphere(1, "wide")
    with pytest.raises(ValueError, match=r"^sphere: subdivisions must be a whole number, got 1\.5$"):
        jd.shapes.sphere(1.5)
    with pytest.raises(ValueError, match=r"^GuidedEdges: sort must be True or False, got 1$"):
        jd.GuidedEdges(sort=1)
    with pytest.raises(ValueError, match=r"^GuidedEdges: cells must be three whole numbers, got \(1, 2\)$"):
        jd.GuidedEdges(cells=(1, 2))
    with pytest.raises(ValueError, match=r"^TwoSided: bsdf must be a BSDF such as jaxdr\.Diffuse\(\), got the class D"):
        jd.TwoSided(jd.Diffuse)
    with pytest.raises(ValueError, match=r"^save_mesh: path must be a path, got 3$"):
        jd.save_mesh(3, jd.shapes.box())
    with pytest.raises(ValueError, match=r"^look_at: up must be made of numbers, got \[\[1\], 2\]$"):
        jd.look_at((0, 0, 0), (1, 0, 0), [[1], 2])
    with pytest.raises(
        ValueError, match=r"^evaluate_views: views must be the views of jaxdr\.load_views, got 'photos'$"
    ):
        jd.evaluate_views(jd.Scene({"ball": jd.Shape(jd.shapes.box())}, wrong_arguments.SCENE.camera), "photos")
    with pytest.raises(ValueError, match=r"^PathTracer: chunk_size must be a whole number, or None, got 'all'$"):
        jd.PathTracer(chunk_size="all")


def test_missing_and_unknown_arguments_are_for_python():
    with pytest.raises(TypeError, match=r"missing .* argument: 'mesh'"):
        jd.save_mesh("a.obj")
    with pytest.raises(TypeError, match="positional arguments"):
        jd.shapes.pawn(8, 8)
    with pytest.raises(TypeError, match="unexpected keyword argument 'colour'"):
        jd.Diffuse(colour=1.0)


def test_numbers_of_all_libraries_are_taken_as_what_they_are():
    for four in (4, 4.0, np.int64(4), np.float32(4), jnp.array(4), np.array(4.0)):
        film = jd.Film(four, four)
        assert film == jd.Film(4, 4) and type(film.width) is int
        assert type(jd.Gaussian(four).stddev) in (int, float)
    assert jd.GuidedEdges(cells=np.array([1, 2, 3])).cells == (1, 2, 3)
    assert jd.GuidedEdges(sort=np.True_).sort is True


def test_traced_values_pass():
    def built(x):
        mesh = jd.shapes.transformed(jd.shapes.box(), x * jnp.eye(4).at[3, 3].set(1 / x))
        light = jd.PointLight([x, 0.0, 1.0], x)
        camera = jd.Perspective(jd.look_at([x, -4, 1], (0, 0, 0), (0, 0, 1)), x, jd.Film(4, 4))
        return mesh.vertices.sum() + light.position.sum() + camera.fov

    assert jax.eval_shape(jax.jit(built), 2.0).shape == ()
    with pytest.raises(ValueError, match="Film: width must be a whole number, got a traced value"):
        jax.eval_shape(lambda n: jnp.zeros(jd.Film(n, 4).width), 4)


def test_signatures_stay():
    assert list(inspect.signature(jd.render).parameters) == ["scene", "key", "spp", "integrator"]
    assert list(inspect.signature(jd.PathTracer).parameters)[:2] == ["max_depth", "boundary"]
    assert jd.render.__doc__ and jd.render.__module__ == "jaxdr.render"


def test_iterators_are_gone_through_once():
    @checked
    def names(names: Iterable[str]):
        return list(names)

    assert names(iter("ab")) == ["a", "b"]


@pytest.mark.parametrize(
    "value, words",
    [
        (np.zeros((2, 3)), "an array of shape [2, 3] (float64)"),
        (jd.Diffuse, "the class Diffuse"),
        (jd.Diffuse(), "a Diffuse"),
        (np.float32(2.5), "2.5"),
        ("a\nb" * 50, "'a\\nba\\nb"),
        ([10**5000], "a number of thousands of digits"),
        (len, "the function len"),
    ],
)
def test_values_are_shown_on_one_short_line(value, words):
    assert shown(value).startswith(words)
    assert "\n" not in shown(value) and len(shown(value)) < 80


@pytest.mark.parametrize("value", [1, 1.5, [1, 2], [[1.0], [2.0]], [], (np.float32(1), jnp.array(2)), range(3)])
def test_what_is_made_of_numbers(value):
    assert made_of_numbers(value)


@pytest.mark.parametrize("value", [None, True, "1", [[1], 2], [1, "a"], 1j, {}, {1}, np.array([True]), np.array(["a"])])
def test_what_is_not_made_of_numbers(value):
    assert not made_of_numbers(value)


def test_names_of_axes_are_not_those_of_the_callers_function():
    """H and W of the caller's picture are others than those of a picture that it passes on."""

    @jaxtyped(typechecker=beartype)
    def half(image: Float[jax.Array, "H W 3"]):
        return jd.losses.l2(image[::2, ::2], image[::2, ::2])

    assert half(jnp.zeros((8, 8, 3))) == 0.0


class Tensor:
    """Of another library: it has a shape and a type, and gives its numbers only if it needs no gradient."""

    shape, dtype = (4, 4, 3), "torch.float32"

    def __array__(self, *_, **__):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")


Tensor.__module__ = "torch"


@pytest.mark.parametrize(
    "call",
    [
        lambda: jd.losses.l2(Tensor(), Tensor()),
        lambda: jd.Picture(Tensor()),
        lambda: jd.Diffuse(Tensor()),
        lambda: jd.render(wrong_arguments.SCENE, Tensor()),
    ],
    ids=["loss", "picture", "material", "key"],
)
def test_tensors_of_pytorch_are_refused_with_the_way_to_go(call):
    with pytest.raises(
        ValueError, match=r"got a tensor of shape \[4, 4, 3\] \(torch.float32\); jaxdr\.torch differentiates tensors"
    ):
        call()


def test_long_lists_are_looked_at_as_arrays():
    rows = [[0.0, 1.0, 2.0]] * 5000
    assert made_of_numbers(rows) and not made_of_numbers([*rows, [1.0]]) and not made_of_numbers([*rows, ["a", 1, 2]])
