"""Every operation that kernels have, against XLA's or NumPy's answer, also for special numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxdr.kernels import fused
from jaxdr.kernels.rows import ELEMENTWISE
from tests.kernels.programs import N, both, operations

FLOATS = np.array([0.0, -0.0, 1.0, -1.0, 0.5, 2.5, -2.5, 3e38, -3e38, 1e-40, np.inf, -np.inf, np.nan, 7.25], np.float32)
SIGNED = np.array([0, 1, -1, 2, 7, -7, 31, 32, 100, 2**31 - 1, -(2**31)], np.int32)
UNSIGNED = np.array([0, 1, 2, 7, 31, 32, 33, 2**31, 2**32 - 1], np.uint32)
KINDS = {"f": FLOATS, "i": SIGNED, "u": UNSIGNED, "b": np.array([True, False])}
UNARY = {
    **dict.fromkeys(("neg", "abs", "sign", "square"), "fi"),
    **dict.fromkeys(("floor", "ceil", "is_finite", "sqrt", "rsqrt", "erf", "logistic", "tanh"), "f"),
    **dict.fromkeys(("exp", "exp2", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan"), "f"),
    "not": "iub",
}
BINARY = {
    **dict.fromkeys(("add", "sub", "mul", "max", "min"), "fiu"),
    **dict.fromkeys(("lt", "gt", "le", "ge", "eq", "ne"), "fiub"),
    **dict.fromkeys(("lt_to", "le_to"), "fiu"),
    **dict.fromkeys(("and", "or", "xor"), "iub"),
    **dict.fromkeys(("shift_left", "shift_right_logical", "shift_right_arithmetic"), "iu"),
    "div": "fiu", "rem": "fiu", "pow": "f", "atan2": "f",
}  # fmt: skip
NAMES = {"and": "bitwise_and", "or": "bitwise_or", "xor": "bitwise_xor", "not": "bitwise_not"}
IN_ORDER = {"lt_to": lax.lt_to_p, "le_to": lax.le_to_p}
# These have tests of their own, or the same rule as another. XLA's cube root is off by 1e-6.
ELSEWHERE = set(
    "cbrt add_any round integer_pow clamp convert_element_type bitcast_convert_type select_n copy copy_p".split()
)


def pairs(kind: str) -> list:
    """All pairs of special numbers, repeated to N rows."""
    values = KINDS[kind]
    a, b = (np.resize(x.ravel(), N) for x in np.meshgrid(values, values))
    return [jnp.asarray(a), jnp.asarray(b)]


def test_every_operation_has_a_case():
    assert UNARY.keys() | BINARY.keys() | ELSEWHERE == set(ELEMENTWISE)


@pytest.mark.parametrize(("name", "kind"), [(n, k) for n, kinds in UNARY.items() for k in kinds])
def test_unary(name, kind):
    both(getattr(lax, NAMES.get(name, name)), pairs(kind)[0], rtol=3e-6)


@pytest.mark.parametrize(("name", "kind"), [(n, k) for n, kinds in BINARY.items() for k in kinds])
def test_binary(name, kind):
    operation = IN_ORDER[name].bind if name in IN_ORDER else getattr(lax, NAMES.get(name, name))
    both(operation, *pairs(kind), rtol=3e-6)


def test_a_search_is_one_kernel():
    table, wanted = jnp.sort(pairs("f")[0][:1000]), pairs("f")[1]

    def search(table, wanted):
        return jnp.searchsorted(table, wanted, side="left"), jnp.searchsorted(table, wanted, side="right")

    both(search, table, wanted)
    assert not operations(search, table, wanted)[1]


@pytest.mark.parametrize("given", "fiub")
@pytest.mark.parametrize("wanted", [jnp.float32, jnp.int32, jnp.uint32, jnp.bool_])
def test_conversions(given, wanted):
    if KINDS[given].dtype == wanted:
        return
    both(lambda a: a.astype(wanted), pairs(given)[0])


@pytest.mark.parametrize("wanted", [jnp.int32, jnp.uint32])
def test_bits_of_floats(wanted):
    ordinary = jnp.nan_to_num(pairs("f")[0])
    both(lambda a: lax.bitcast_convert_type(a, wanted), ordinary)
    both(lambda a: lax.bitcast_convert_type(lax.bitcast_convert_type(a, wanted) + wanted(1), jnp.float32), ordinary)


@pytest.mark.parametrize("exponent", [-3, -1, 0, 1, 2, 5, 7])
def test_powers(exponent):
    x = jnp.linspace(-3.0, 3.1, N)
    both(lambda a: a**exponent, x, rtol=2e-6)


@pytest.mark.parametrize("way", list(lax.RoundingMethod))
def test_rounding(way):
    both(lambda a: lax.round(a, way), pairs("f")[0])


def test_choices():
    a, b = pairs("f")
    both(lambda a, b: jnp.where(a > b, a, b), a, b)
    both(lambda a, b: jnp.where(jnp.isnan(a), 1.0, b), a, b)
    both(lambda a, b: jnp.clip(a, -1.0, b), a, b)


def test_several_components():
    """Structure: what moves components, in every way that a row allows; rows first, last, and in the middle."""
    x = jnp.asarray(np.random.default_rng(0).normal(size=(N, 2, 3)), jnp.float32)
    functions = (
        lambda x: x.reshape(N, 6),
        lambda x: x.transpose(2, 0, 1),
        lambda x: jnp.flip(x, 2),
        lambda x: x[:, :, ::2],
        lambda x: jnp.stack([x, x + 1], 1),
        lambda x: jnp.concatenate([x, x[:, :1] * 2], 1),
        lambda x: jnp.pad(x, ((0, 0), (1, 0), (0, 2)), constant_values=7),
        lambda x: lax.pad(x, 0.0, [(0, 0, 0), (-1, 0, 0), (0, -1, 0)]),
        lambda x: lax.split(x, (1, 1), 1),
        lambda x: x[:, 1, None] + x[:, :1, :],
        lambda x: x * jnp.asarray([1.0, 2.0, 3.0]),
        lambda x: [x.sum(1), x.sum((1, 2)), x.max(2), x.min(1), x.prod(2), (x > 0).any(2), (x > 0).all(1)],
        lambda x: x.transpose(1, 0, 2).sum(0),
        lambda x: jnp.einsum("nij,jk->nik", x, jnp.arange(6.0).reshape(3, 2)),
        lambda x: jnp.einsum("nij,nkj->nik", x, x),
        lambda x: jnp.einsum("nij,nij->n", x, x),
        lambda x: x + lax.broadcasted_iota(jnp.float32, x.shape, 0) + lax.broadcasted_iota(jnp.float32, x.shape, 2),
        lambda x: lax.bitcast_convert_type(jnp.arange(N), jnp.float32)[:, None, None] + x,
    )
    for function in functions:
        both(function, x, rtol=2e-6, atol=1e-6)


@pytest.mark.parametrize("mode", ["clip", "fill", "promise_in_bounds"])
def test_lookups(mode):
    rng = np.random.default_rng(1)
    reach = (0, 10) if mode == "promise_in_bounds" else (-3, 20)
    index = jnp.asarray(rng.integers(*reach, (N, 2)), jnp.int32)
    table = jnp.asarray(rng.normal(size=(10, 3)), jnp.float32)
    for kind in (jnp.float32, jnp.int32, jnp.uint32, jnp.bool_):
        both(lambda t, i: t.at[i[:, 0]].get(mode=mode), (table * 3).astype(kind), index)
    both(lambda t, i: t.at[i].get(mode=mode), table, index)
    both(lambda t, i: t.at[i.astype(jnp.uint32)].get(mode=mode), table, jnp.abs(index))
    both(
        lambda t, i: t.at[i[:, 0], i[:, 1]].get(mode=mode),
        jnp.asarray(rng.normal(size=(10, 12, 2)), jnp.float32),
        index,
    )


@pytest.mark.parametrize("mode", ["clip", "drop"])
def test_sums(mode):
    rng = np.random.default_rng(2)
    index = jnp.asarray(rng.integers(-3, 20, (N, 2)), jnp.int32)
    x = jnp.asarray(rng.normal(size=(N, 2, 3)), jnp.float32)

    def sums(x, i):
        table = jnp.ones((10, 3)).at[i].add(x * 2, mode=mode)
        return [
            table,
            x.sum(0),
            x.sum((0, 2)),
            x.sum(),
            (x > 0).sum(0),
            jnp.zeros(10, jnp.int32).at[i[:, 0]].add(1, mode=mode),
        ]

    both(sums, x, index, rtol=1e-4, atol=1e-4)


def test_what_kernels_do_not_have_is_left_to_xla():
    x = jnp.asarray(np.random.default_rng(3).normal(size=(N,)), jnp.float32)
    assert operations(lambda x: jnp.sort(jnp.cumprod(x * 2)) + 1, x) == (2, {"cumprod", "sort"})
    assert operations(lambda x: x.astype(jnp.float16) * 2, x)[0] == 0


def test_nothing_is_taken_for_rows_of_another():
    """Shapes alone do not tell: an axis of N numbers that are summed, turned or shifted is not an axis of rows."""
    x = jnp.asarray(np.random.default_rng(4).normal(size=(N, 3)), jnp.float32)
    both(lambda x: (x[::-1] + x) * 2, x)
    both(lambda x: jnp.roll(x, 1, 0) + x, x)
    both(lambda x: jnp.concatenate([x[3:], x[:3]]) + x, x)
    both(lambda x: x.reshape(3, N).T + x, x)
    both(lambda x: x.T.reshape(N, 3) + x, x)
    both(lambda x: x + x.sum(0) * 1e-3, x, rtol=1e-4, atol=1e-4)
    both(lambda x: x @ (x.T @ x) * 1e-3, x, rtol=1e-4, atol=1e-4)
    both(lambda x: jnp.where(x[0, 0] > 9, x, x[:, ::-1]), x)


def test_known_arrays():
    """A function inside may know an array with rows, a key, or one number for all rows."""
    rows, key = jnp.arange(float(N)), jax.random.key(3)
    inner = jax.jit(lambda x: x * 2.0 + rows[:, None] + jax.random.uniform(key, (3,)))
    both(lambda x: inner(x) + 1, jnp.ones((N, 3)), rtol=1e-6)
    both(lambda x: jnp.zeros(4).at[jnp.arange(N) % 4].add(x[:, 0]), jnp.ones((N, 3)))


def test_axes_without_numbers():
    x = jnp.ones((N, 3))
    both(lambda x: x[:, :0].sum(1) + 2 * x[:, 0], x)
    both(lambda x: [jnp.einsum("ni,ij->nj", x[:, :0], jnp.ones((0, 2))), x * 2], x)
    both(lambda x: [jnp.concatenate([x * 2, x[:0]]), x[:, :0].sum(0)], x)
    both(lambda x: jnp.zeros((0, 3)).at[jnp.zeros(N, int)].add(x).sum() + x * 2, x)


def test_lanes_do_not_depend_on_their_neighbours():
    """An infinite angle in a row changes nothing in other rows, to the bit."""
    x = jnp.linspace(-50.0, 50.0, N)
    function = jax.jit(fused(lambda x: (jnp.sin(x), jnp.cos(x))))
    for a, b in zip(function(x), function(x.at[::3].set(jnp.inf)), strict=True):
        keep = np.arange(N) % 3 != 0
        np.testing.assert_array_equal(a[keep], b[keep])


@pytest.mark.parametrize("shape", [(N,), (N, 6), (2, N, 3), (4, 3, N), (3, 3)])
def test_random_bits(shape):
    """Those of JAX, bit for bit."""

    def function(key, x):
        return jax.random.bits(jax.random.fold_in(key, 7), shape), jax.random.uniform(key, shape), jnp.sin(x)

    both(function, jax.random.key(3), jnp.ones(N), rtol=1e-6)
    assert ("random_bits" in operations(function, jax.random.key(3), jnp.ones(N))[1]) == (N not in shape)
