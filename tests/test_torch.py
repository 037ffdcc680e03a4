"""`jaxdr.torch`: values and derivatives are those of JAX; PyTorch's own check of gradients; wrong arguments."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

torch = pytest.importorskip("torch", reason='PyTorch is not installed: pip install -e ".[torch]"')
import jaxdr.torch as jdt  # noqa: E402

KEY = jax.random.key(3)


@pytest.fixture(autouse=True)
def _float64():
    with jax.enable_x64(True):
        yield


def smooth_scene() -> jd.Scene:
    """A large board under a point light: no silhouette is seen, and nothing is hidden."""
    board = jd.Shape(jd.shapes.rectangle(40.0, 40.0), jd.Diffuse((0.5, 0.4, 0.3)))
    camera = jd.Perspective(jd.look_at((0.3, -2, 4), (0, 0, 0), (0, 0, 1)), 30.0, jd.Film(3, 2))
    scene = jd.Scene({"board": board}, camera, lights={"bulb": jd.PointLight((0.5, 0.2, 2.0), 5.0)})
    return jax.tree.map(lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, scene)


def ball_scene() -> jd.Scene:
    ball = jd.Shape(jd.shapes.sphere(1, radius=0.5), jd.Diffuse((0.8, 0.5, 0.3)))
    camera = jd.Perspective(jd.look_at((0, -4, 1), (0, 0, 0), (0, 0, 1)), 25.0, jd.Film(6, 6))
    return jd.Scene({"ball": ball}, camera, jd.ConstantEnvironment(1.0))


def tensor(array, **settings):
    return torch.tensor(np.asarray(array), **settings)


# A function without randomness


def numbers(parameters, factor, name):
    """Several results of several kinds."""
    x, y = parameters["x"], parameters["y"]
    return {"smooth": jnp.sin(x) @ y * factor, "whole": jnp.arange(3), "name": [jnp.ones(len(name))]}


def values():
    x = torch.linspace(-1, 2, 12, dtype=torch.float64).reshape(4, 3)
    return {"x": x.requires_grad_(), "y": torch.tensor([1.0, -2, 0.5], dtype=torch.float64, requires_grad=True)}


def test_values_are_those_of_the_function():
    given, function = values(), jdt.from_jax(numbers)
    found = function(given, 2.0, "four")
    assert set(found) == {"smooth", "whole", "name"} and found["name"][0].shape == (4,)
    expected = np.sin(given["x"].detach().numpy()) @ given["y"].detach().numpy() * 2
    np.testing.assert_allclose(found["smooth"].detach().numpy(), expected, rtol=1e-12)
    assert found["smooth"].requires_grad and not found["whole"].requires_grad
    assert function.__doc__ == numbers.__doc__


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_pytorch_finds_both_derivatives_right():
    given, function = values(), jdt.from_jax(numbers)

    def smooth(x, y):
        return function({"x": x, "y": y}, 2.0, "four")["smooth"]

    assert torch.autograd.gradcheck(smooth, tuple(given.values()), check_forward_ad=True)


def test_without_gradients_nothing_is_kept():
    function = jdt.from_jax(numbers)
    with torch.no_grad():
        assert not function(values(), 2.0, "four")["smooth"].requires_grad


def test_a_tensor_that_needs_no_gradient_is_not_differentiated():
    given, seen = values(), []

    def watched(x, y):
        seen.append((isinstance(x, jax.core.Tracer), type(x).__name__, type(y).__name__))
        return (x * y).sum()

    jdt.from_jax(watched)(given["x"], given["y"].detach()).backward()
    assert given["x"].grad is not None
    _, differentiated, fixed = seen[-1]
    assert differentiated != fixed  # one is a tracer of the derivative, the other of the program alone


def test_nothing_is_compiled_again():
    calls = []

    def counted(x):
        calls.append(x)
        return jnp.sum(x**2)

    function = jdt.from_jax(counted)
    compiled = []
    for i in range(3):
        x = torch.full((4,), float(i), requires_grad=True)
        function(x).backward()
        np.testing.assert_allclose(x.grad.numpy(), 2 * i)
        compiled.append(jdt._pulled_back._cache_size())
    assert len(calls) == 1 and compiled[0] == compiled[-1]


def test_memory_is_shared():
    given = torch.arange(6.0)
    assert jdt._array(given).unsafe_buffer_pointer() == given.data_ptr()
    array = jnp.arange(4.0)
    assert jdt._tensor(array).data_ptr() == array.unsafe_buffer_pointer()


def test_any_strides_are_read():
    given = torch.arange(6.0).reshape(2, 3)
    for view in (given.T, given[:, 1], given.flip(0), given[::2], given[:0], torch.tensor(2.0)):
        found = jdt.from_jax(lambda x: 2 * x)(view)
        np.testing.assert_array_equal(found.numpy(), 2 * view.numpy())


def test_a_tensor_that_was_changed_in_between_is_refused():
    x = torch.ones(3, requires_grad=True)
    y = jdt.from_jax(lambda x: jnp.sum(x**3))(x)
    with torch.no_grad():
        x += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        y.backward()


ONLY = "first derivatives only"


def cube(x):
    return x**3


def gradient_penalty(function):
    x = torch.ones(3, requires_grad=True)
    y = function(x).sum()
    (first,) = torch.autograd.grad(y, x, create_graph=True)
    (y + first.pow(2).sum()).backward()


def forward_over_reverse(function):
    x = torch.ones(3, requires_grad=True)
    with torch.autograd.forward_ad.dual_level():
        y = function(torch.autograd.forward_ad.make_dual(x, torch.ones(3))).sum()
        return torch.autograd.grad(y, x, create_graph=True)


def reverse_over_forward(function):
    x = torch.ones(3, requires_grad=True)
    with torch.autograd.forward_ad.dual_level():
        y = function(torch.autograd.forward_ad.make_dual(x, torch.ones(3)))
        return torch.autograd.grad(torch.autograd.forward_ad.unpack_dual(y).tangent.sum(), x)


@pytest.mark.parametrize(
    "second",
    [
        lambda f: torch.autograd.functional.hessian(lambda x: f(x).sum(), torch.ones(3)),
        lambda f: torch.autograd.functional.hvp(lambda x: f(x).sum(), torch.ones(3), torch.ones(3)),
        gradient_penalty,
        forward_over_reverse,
        reverse_over_forward,
    ],
    ids=["hessian", "hvp", "penalty", "forward over reverse", "reverse over forward"],
)
def test_second_derivatives_are_refused(second):
    """They would be zero without a word."""
    with pytest.raises(RuntimeError, match=ONLY):
        second(jdt.from_jax(cube))


@pytest.mark.filterwarnings("ignore::FutureWarning")
@pytest.mark.parametrize(
    "function",
    [lambda z: jnp.real(z * z), lambda z: jnp.sin(z) * z, lambda z: jnp.abs(z)],
    ids=["real", "holomorphic", "magnitude"],
)
def test_complex_numbers_have_the_derivatives_of_pytorch(function):
    z = torch.tensor([1 + 2j, 3 - 1j, -0.5 + 0.1j], dtype=torch.complex128, requires_grad=True)
    assert torch.autograd.gradcheck(jdt.from_jax(function), (z,), check_forward_ad=True)
    x = torch.tensor([0.3, 2.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(jdt.from_jax(lambda x: jnp.exp(1j * x) * x), (x,), check_forward_ad=True)


def test_several_backward_passes():
    x = torch.ones(3, requires_grad=True)
    y = jdt.from_jax(cube)(x).sum()
    y.backward(retain_graph=True)
    y.backward()
    np.testing.assert_allclose(x.grad.numpy(), 6.0)


def test_results_are_nobody_elses_memory():
    """Changing a result in place changes neither the argument nor the gradient."""
    x = torch.ones(3, requires_grad=True)
    y = jdt.from_jax(lambda x: (x, 2 * x))(x)
    with torch.no_grad():
        y[0].fill_(7.0)
    np.testing.assert_array_equal(x.detach().numpy(), 1.0)
    y[1].sum().backward()
    x.grad.zero_()
    np.testing.assert_array_equal(y[1].detach().numpy(), 2.0)


def test_arguments_by_name_flags_and_methods():
    @jdt.from_jax
    def scaled(x, *, by=2.0, negative=False):
        """Its words."""
        return -by * x if negative else by * x

    class Scaler:
        by = 3.0

        @jdt.from_jax
        def scaled(self, x):
            return self.by * x

    x = torch.ones(2)
    assert scaled(x, by=3.0).tolist() == [3, 3] and scaled(x, negative=True).tolist() == [-2, -2]
    assert scaled.__name__ == "scaled" and scaled.__doc__ == "Its words."
    assert Scaler().scaled(x).tolist() == [3, 3]


def test_a_jitted_function_is_taken_without_its_jit():
    x = torch.ones(3, requires_grad=True)
    jdt.from_jax(jd.jit(cube))(x).sum().backward()
    np.testing.assert_allclose(x.grad.numpy(), 3.0)


# Renderings


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_gradcheck_of_a_smooth_rendering():
    """The value of the interior term is the image, and its derivative is that of the same samples."""
    scene, given = smooth_scene(), smooth_scene().parameters()
    names = ["board.vertices", "bulb.position", "board.bsdf.reflectance"]
    tracer = jd.PathTracer(max_depth=2)

    def interior(values, key):
        return jd.derivative_terms(scene.replace(values), key, 2, tracer)["interior"]

    function = jdt.from_jax(interior)
    tensors = [tensor(given[name], requires_grad=True) for name in names]
    assert torch.autograd.gradcheck(lambda *x: function(dict(zip(names, x, strict=True)), KEY), tensors, atol=1e-7)


def test_the_image_and_its_gradient_are_those_of_jax():
    scene, names = ball_scene(), ["ball.vertices", "ball.bsdf.reflectance", "environment.radiance"]
    given = {name: scene.parameters()[name] for name in names}
    tracer = jd.PathTracer(max_depth=2)

    def loss(values):
        return jnp.sum(jd.render(scene.replace(values), KEY, 8, tracer) ** 2)

    expected, gradient = jd.jit(jax.value_and_grad(loss))(given)
    tensors = {name: tensor(value, requires_grad=True) for name, value in given.items()}
    image = jdt.render(scene, tensors, KEY, 8, tracer)
    assert image.shape == (6, 6, 3) and image.dtype == torch.float64
    found = (image**2).sum()
    found.backward()
    np.testing.assert_allclose(float(found.detach()), float(expected), rtol=1e-6)
    for name in names:
        ours, theirs = tensors[name].grad.numpy(), np.asarray(gradient[name])
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5 * np.abs(theirs).max(), err_msg=name)


def test_forward_mode_is_a_derivative_image():
    scene = ball_scene()
    albedo = scene.parameters()["ball.bsdf.reflectance"]
    tracer = jd.PathTracer(max_depth=2)

    def image(x):
        return jd.render(scene.replace({"ball.bsdf.reflectance": x}), KEY, 4, tracer)

    expected = jd.jit(lambda x: jax.jvp(image, (x,), (jnp.ones_like(x),)))(albedo)
    with torch.autograd.forward_ad.dual_level():
        moved = torch.autograd.forward_ad.make_dual(tensor(albedo), torch.ones(3))
        found = torch.autograd.forward_ad.unpack_dual(jdt.from_jax(image)(moved))
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(ours.numpy(), theirs, rtol=1e-5, atol=1e-6)


def test_a_renderer_is_kept():
    tracer = jd.PathTracer(max_depth=2)
    assert jdt._renderer(4, tracer) is jdt._renderer(4, jd.PathTracer(max_depth=2))


# Wrong arguments


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jdt.from_jax(jnp.sum)(torch.ones(3).to_sparse()), "can't be shared with JAX"),
        (lambda: jdt.from_jax(jnp.sum)(torch.ones(3, device="meta")), "can't be shared with JAX"),
        (lambda: jdt.from_jax(lambda x: None)(torch.ones(3)), "returned NoneType where an array was expected"),
        (lambda: jdt.from_jax(lambda x: KEY)(torch.ones(3)), "returned a random key where an array was expected"),
        (lambda: jdt.from_jax(jnp.sum)(torch.ones(3), axis={0, 1}), "an argument that is no number and no array"),
        (lambda: jax.jit(jdt.from_jax(jnp.sum))(jnp.ones(3)), "call the function of JAX arrays itself"),
        (lambda: jdt.render(ball_scene(), {}, KEY, 1, guided()), "this integrator has arrays, such as guides"),
    ],
    ids=["sparse", "no memory", "no array", "key", "static", "inside of jit", "guides"],
)
def test_one_line_says_what_is_wrong(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


def guided() -> jd.PathTracer:
    return jd.PathTracer(max_depth=2, boundary=jd.build_guides(ball_scene(), jd.GuidedEdges()))


def test_int64_is_not_shortened_silently():
    with jax.enable_x64(False):
        assert jdt.from_jax(jnp.sum)(torch.tensor([1, 2])).item() == 3
        with pytest.raises(ValueError, match="don't fit into JAX's int32"):
            jdt.from_jax(jnp.sum)(torch.tensor([2**40]))


def test_float64_is_not_shortened_silently():
    with jax.enable_x64(False), pytest.raises(ValueError, match="JAX computes in float32"):
        jdt.from_jax(jnp.sum)(torch.ones(3, dtype=torch.float64))


def test_an_unknown_name_is_refused():
    with pytest.raises(ValueError, match=r"unknown parameter 'ball\.vertexes'"):
        jdt.render(ball_scene(), {"ball.vertexes": torch.ones(3)}, KEY, 1)


def test_without_the_type_checker_of_the_tests():
    calls = "jdt.from_jax(3)", "jdt.render(scene, {}, 0)"
    program = f"""
import jaxdr as jd, jaxdr.torch as jdt
pose = jd.look_at((0, -4, 1), (0, 0, 0), (0, 0, 1))
scene = jd.Scene({{"box": jd.Shape(jd.shapes.box())}}, jd.Perspective(pose, 9.0, jd.Film(4, 4)))
for call in {calls}:
    try:
        eval(call)
    except ValueError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    function, key = done.stdout.splitlines()
    assert function == "from_jax: function must be a function, got 3"
    assert key == "render: key must be a random key such as jax.random.key(0), got 0"


def test_without_pytorch_one_line_says_how_to_install_it():
    program = "import sys; sys.modules['torch'] = None; import jaxdr.torch"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.strip().endswith('jaxdr.torch needs PyTorch, which is optional: pip install -e ".[torch]"')
