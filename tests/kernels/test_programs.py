"""Loops, branches, batches, threads, and whole renderings."""

import dataclasses
import logging
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxdr as jd
from jaxdr.kernels import fused, machine
from jaxdr.kernels.flatten import flat
from jaxdr.kernels.levels import Cluster, planned
from jaxdr.kernels.rows import SUMMED
from jaxdr.kernels.text import KernelWriter
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.keys import fixed_key, inner_key
from tests.kernels.programs import N, both, operations


@pytest.fixture
def x():
    return jnp.asarray(np.random.default_rng(0).normal(size=(N, 3)), jnp.float32)


def test_scans(x):
    def turn(carry, y):
        rows, total = carry
        return (rows * 0.5 + y, total + rows.sum(0)), rows[:, 0]

    both(lambda x: lax.scan(turn, (x, jnp.zeros(3)), jnp.arange(50.0)), x, rtol=1e-4, atol=1e-4)
    both(lambda x: lax.scan(turn, (x, jnp.zeros(3)), jnp.arange(50.0), reverse=True), x, rtol=1e-4, atol=1e-4)
    both(lambda x: lax.fori_loop(0, 5, lambda i, x: jnp.sin(x) + i, x), x, rtol=1e-5, atol=1e-6)  # written out


def test_loops_whose_end_is_a_value(x):
    def body(state):
        i, rows = state
        part = lax.dynamic_slice_in_dim(rows, i, 600) * 2
        return i + 1, lax.dynamic_update_slice_in_dim(rows, part, 0, 0) + rows[jnp.arange(N) // 2]

    both(lambda x: lax.while_loop(lambda s: (s[0] < 4) & (s[1][0, 0] < 1e9), body, (0, x)), x, rtol=1e-5)


def test_loops_that_end_one_by_one(x):
    """Many loops by `vmap`: those that have ended keep their values while others go on."""

    def rows(x, count):
        return lax.while_loop(lambda s: s[0] < count, lambda s: (s[0] + 1, jnp.sin(s[1]) + s[0]), (0, x))

    def numbers(count):
        return lax.while_loop(lambda s: s[0] < count, lambda s: (s[0] + 1, s[1] * 1.01), (0, 1.0))

    counts = jnp.asarray([0, 3, 7])
    both(lambda x, counts: jax.vmap(rows, (None, 0))(x, counts), x, counts, rtol=1e-5, atol=1e-6)
    both(lambda x, counts: jax.vmap(rows)(x * jnp.ones((3, 1, 1)), counts), x, counts, rtol=1e-5, atol=1e-6)
    both(jax.vmap(numbers), jnp.arange(N) % 9, rtol=1e-5)


@pytest.mark.parametrize("mode", ["drop", "clip"])
def test_rows_that_a_loop_adds_to(x, mode):
    """To a table that is too large for sums of each thread's own; twice to some rows, and past the end."""
    table = jnp.asarray(np.random.default_rng(1).normal(size=(SUMMED // 2, 3)), jnp.float32)

    def turn(i, table, x):
        index = (jnp.arange(N) * 7 + 2000 * i) % (table.shape[0] + 9)
        table = table.at[index].add(x * i, mode=mode)
        return table.at[index[:5] + 1].set(x[:5], mode=mode)

    def rows_added(table, x):
        return lax.fori_loop(0, 40, lambda i, table: turn(i, table, x), table)

    both(rows_added, table, x, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("mode", ["drop", "clip"])
def test_one_row_is_changed(x, mode):
    both(lambda x: (x * 2).at[3].set(1.0, mode=mode) + (x * 3).at[5].add(x[2], mode=mode), x)
    both(lambda x: (x[:, 0] * 2).at[3].set(1.0, mode=mode).at[N + 4].add(2.0, mode=mode), x)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(("rows", "size"), [(N, None), (N, 100), (N, 2 * N), (300_001, None)])
def test_rows_that_count(share, rows, size):
    numbers = jax.random.uniform(jax.random.key(0), (rows,))

    def function(numbers):
        return rows_where(numbers < share, size, 7)

    both(function, numbers)
    both(lambda numbers: jax.vmap(function)(numbers[None]), numbers)
    assert not operations(function, numbers)[1]


@pytest.mark.parametrize("reverse", [False, True])
def test_running_sums(x, reverse):
    def sums(x):
        whole = (10 * x).astype(jnp.int32)
        table = x.reshape(17, -1, 3)
        sums_of_table = [lax.cumsum(table, axis, reverse=reverse) for axis in range(3)]
        return lax.cumsum(x[:, 0], reverse=reverse), lax.cumsum(whole[:, 1], reverse=reverse), sums_of_table, x * 2

    both(sums, x, rtol=1e-4, atol=1e-5)
    assert "cumsum" not in operations(sums, x)[1]
    many = jnp.full(1 << 22, 0.1)
    found = jax.jit(fused(lambda x: lax.cumsum(x, reverse=reverse)))(many)
    exact = np.cumsum(np.asarray(many, float))
    np.testing.assert_allclose(found, exact[::-1] if reverse else exact, rtol=1e-6)


def test_keys_that_follow_from_a_key(x):
    """By a handler, bit for bit as `jaxdr.transport.keys` has them; batches of keys are left to XLA."""

    def derived(x, seed):
        key = inner_key(jax.random.key(seed))
        keys = [jax.random.fold_in(key, ~seed), *jax.random.split(key), *jax.random.split(key, (2, 3)).ravel()]
        return [jax.random.key_data(key) for key in keys], x * 2

    both(derived, x, jnp.uint32(7))
    assert not {"random_split", "random_fold_in"} & operations(derived, x, jnp.uint32(7))[1]
    both(lambda x: jax.random.key_data(jax.vmap(jax.random.split)(jax.random.split(fixed_key(3), 5))) + x.sum(), x)


def test_numbers_that_all_rows_share(x):
    """They are taken apart and put together in kernels, and for XLA, too."""

    def function(x, frame, total):
        a, b, c = jnp.unstack(frame)
        turned = jnp.stack([b, jnp.squeeze(lax.slice(total * c, (1,), (2,))) * jnp.ones(3), a[::-1]])
        apart = jnp.unstack(turned.reshape(-1))
        return x * apart[0] + x @ turned + apart[4], jnp.linalg.norm(turned), x.sum(0) * jnp.stack(apart[:3])

    both(function, x, x[:3], x[0], rtol=1e-5, atol=1e-4)


def test_branches(x):
    def branch(x, k):
        return lax.cond(k > 0, lambda x: (x * 2, x.sum()), lambda x: (x[:, ::-1], x.max()), x + 1)

    for k in (0, 1):
        both(branch, x, jnp.int32(k), rtol=1e-5, atol=1e-4)
        both(lambda x, k: lax.switch(k, [lambda x: x + 1, lambda x: x * 2, lambda x: -x], x), x, jnp.int32(k + 1))


def test_batches(x):
    def function(x, a):
        return (jnp.sin(x) * a).sum(1)

    expected = jax.vmap(function, (None, 0))(x, jnp.arange(4.0))
    found = jax.jit(jax.vmap(fused(function), (None, 0)))(x, jnp.arange(4.0))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_members_of_a_batch_have_the_kernels_and_the_bits_of_one(x, caplog):
    def function(x, scale):
        return lax.fori_loop(0, 40, lambda i, x: jnp.sin(x) * scale + i, x).sum(0)

    def run(function, scale):
        caplog.clear()
        with caplog.at_level(logging.INFO, "jaxdr.kernels"):
            return np.asarray(jax.jit(function)(x, scale)), caplog.text

    scales = jnp.arange(24.0).reshape(2, 4, 3)
    found, text = run(jax.vmap(jax.vmap(fused(function), (None, 0)), (None, 1)), scales)
    for i, j in np.ndindex(2, 4):
        one, text_of_one = run(fused(function), scales[i, j])
        np.testing.assert_array_equal(found[j, i], one)
    assert text == text_of_one and "kernels; left to XLA" in text


def test_arrays_that_a_function_closes_over(x):
    table = jnp.arange(4000.0)
    np.testing.assert_array_equal(fused(lambda y: y[:, 0] + table[:N])(x), x[:, 0] + table[:N])
    inside = jax.jit(lambda x, t: fused(lambda y: y * t[:3])(x))(x, table)
    np.testing.assert_array_equal(inside, x * table[:3])


def test_texts_do_not_depend_on_the_number_of_rows():
    def texts(rows):
        shape = jax.ShapeDtypeStruct((rows, 3), jnp.float32)
        closed = jax.make_jaxpr(lambda x: (jnp.sin(x).sum(1), x.sum(0)))(shape)
        _, equations, outputs = flat(closed)
        plan = planned(equations)
        writers = [
            KernelWriter(s.rows, s.equations, plan.free, (), (), {}) for s in plan.steps if isinstance(s, Cluster)
        ]
        return [w.finished({}, outputs).text for w in writers]

    assert texts(1000) == texts(70_001)


_DIGESTS = """
import hashlib, os, sys
os.sched_setaffinity(0, list(os.sched_getaffinity(0))[: int(sys.argv[1])])
import jax, jax.numpy as jnp, numpy as np
from jaxdr.kernels import fused
x = jax.random.normal(jax.random.key(0), (100_003, 3))
i = jax.random.randint(jax.random.key(1), (100_003,), 0, 50)
f = jax.jit(fused(lambda x, i: (jnp.zeros((50, 3)).at[i].add(jnp.exp(x)), x.sum(0))))
for _ in range(2):
    print(hashlib.sha256(b"".join(np.asarray(r).tobytes() for r in f(x, i))).hexdigest())
"""


def test_bits_do_not_depend_on_threads():
    """Sums have a fixed order. In processes of one core and of all, and in two runs, they are the same."""
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("needs Linux")

    def run(cores: int) -> list[str]:
        command = [sys.executable, "-c", _DIGESTS, str(cores)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()

    found = {line for cores in (1, 64) for line in run(cores) if len(line) == 64}
    assert len(found) == 1, found


def test_a_machine_without_a_compiler_takes_xla(x, monkeypatch, caplog):
    def refuse(*_):
        raise machine.CompilerError("no compiler")

    monkeypatch.setattr(machine, "_build", refuse)
    with caplog.at_level(logging.WARNING, "jaxdr.kernels"):
        found = jax.jit(fused(lambda x: jnp.cos(x) + 0.123))(x)
    np.testing.assert_allclose(found, jnp.cos(x) + 0.123, rtol=1e-6)
    assert "no compiler" in caplog.text


def test_machine_code_is_kept_and_damage_is_mended(x, monkeypatch, tmp_path):
    monkeypatch.setattr(machine, "user_folder", lambda: tmp_path)

    def run():
        monkeypatch.setattr(machine, "_targets", {})  # as in a new process
        return np.asarray(jax.jit(fused(lambda x: jnp.sin(x) * 0.4567))(x))

    first = run()
    (path,) = (tmp_path / "kernels").glob("*.o")
    kept = path.stat().st_ino
    np.testing.assert_array_equal(run(), first)
    assert path.stat().st_ino == kept
    path.write_bytes(b"damaged")
    with pytest.raises(machine.CompilerError, match="can't be loaded; it is deleted"):
        machine._loaded(path.stem, "")
    assert not path.exists()
    np.testing.assert_array_equal(run(), first)
    assert path.exists()


def test_a_folder_that_is_not_writable(x, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(machine, "user_folder", lambda: tmp_path / "file")
    np.testing.assert_array_equal(jax.jit(fused(lambda x: x * 0.321))(x), x * jnp.float32(0.321))


def test_few_objects_are_kept(x, monkeypatch, tmp_path):
    monkeypatch.setattr(machine, "user_folder", lambda: tmp_path)
    monkeypatch.setattr(machine, "KEPT", 2)
    for factor in range(4):
        jax.jit(fused(lambda x, f=factor: x * (f + 0.789)))(x)
    assert len(list((tmp_path / "kernels").glob("*.o"))) == 2


SCENES = {
    "lamp": (jd.Diffuse(0.5), jd.PathTracer(max_depth=2, boundary=None)),
    "kernel density": (jd.Diffuse(0.5), jd.PathTracer(max_depth=2)),
    "rough metal": (jd.RoughConductor(alpha=0.2), jd.PathTracer(max_depth=3, boundary=None)),
    "principled": (jd.Principled(roughness=0.4, metallic=0.3), jd.PathTracer(max_depth=3, boundary=jd.LineSampling())),
    "glass": (jd.Dielectric(), jd.PathTracer(max_depth=4)),
    "bidirectional": (jd.Diffuse(0.5), jd.BidirectionalPathTracer(max_depth=3)),
}


def loss_of(bsdf, integrator):
    """(offset of a ball, key) -> (mean square of its image, the image)."""
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    scene = jd.Scene(
        shapes={
            "ball": jd.Shape(jd.shapes.sphere(2, radius=0.5, center=(0.0, 0.0, 0.8)), bsdf),
            "floor": jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5))),
            "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0)),
        },
        camera=jd.Perspective(jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), fov=35.0, film=jd.Film(16, 16)),
    )

    def loss(offset, key):
        image = jd.render(jd.move(scene, {"ball.translate": offset}), key, 8, integrator)
        return jnp.square(image).mean(), image

    return loss


@pytest.mark.parametrize(
    "name", ["lamp", *(pytest.param(name, marks=pytest.mark.slow) for name in SCENES if name != "lamp")]
)
def test_renderings(name):
    """Images and gradients by kernels are those of XLA. A comparison that rounding turns over changes single paths."""
    bsdf, integrator = SCENES[name]

    def values(compute):
        loss = loss_of(bsdf, dataclasses.replace(integrator, compute=compute))
        return jax.jit(jax.grad(loss, has_aux=True))(jnp.asarray([0.1, 0.0, 0.0]), jax.random.key(0))

    (gradient, image), (expected, reference) = values("kernels"), values("xla")
    np.testing.assert_allclose(gradient, expected, atol=0.01 * np.abs(expected).max())
    off = np.abs(image - reference).max(-1) > 1e-4 * np.abs(reference).max()
    assert off.mean() < 0.02


def test_a_batch_of_renderings():
    """By keys and by places, the images and gradients of single calls."""
    gradient = jax.grad(loss_of(jd.Diffuse(0.5), jd.PathTracer(max_depth=2, compute="kernels")), has_aux=True)
    keys, offsets = jax.random.split(jax.random.key(0), 3), jnp.linspace(0.0, 0.2, 3)[:, None] * jnp.ones(3)
    found, one = jax.jit(jax.vmap(gradient))(offsets, keys), jax.jit(gradient)
    for i in range(3):
        expected = one(offsets[i], keys[i])
        np.testing.assert_allclose(found[0][i], expected[0], atol=1e-5 * np.abs(expected[0]).max())
        np.testing.assert_allclose(found[1][i], expected[1], atol=1e-6)


def test_few_rows_are_left_to_xla(x, caplog):
    """Counted in loops, too, and after `vmap`."""

    def looped(x):
        return lax.fori_loop(0, 40, lambda i, x: x * 1.01, x)

    batch = jnp.broadcast_to(x[:100], (N // 10, 100, 3))
    for function, array, by_kernels in (
        (fused(looped, x.size), x, True),
        (fused(looped, x.size), x[:100], False),
        (jax.vmap(fused(looped, x.size)), batch, True),
    ):
        caplog.clear()
        with caplog.at_level(logging.INFO, "jaxdr.kernels"):
            found = jax.jit(function)(array)
        np.testing.assert_allclose(found, looped(array), rtol=1e-5)
        assert ("kernels; left to XLA" in caplog.text) == by_kernels


def test_where_it_is_differentiated_xla_computes(x):
    table = jnp.arange(5.0)

    def of(x, number):
        return (jnp.sin(x) * x + table[number]).sum()

    expected = jax.grad(of)(x, 3)
    np.testing.assert_allclose(jax.grad(fused(of))(x, 3), expected, atol=1e-6)
    np.testing.assert_allclose(jax.jit(jax.grad(fused(of)))(x, 3), expected, atol=1e-6)


def test_names_of_what_is_left_to_xla(x, caplog):
    with caplog.at_level(logging.INFO, "jaxdr.kernels"):
        jax.jit(fused(lambda x: jnp.cumprod(x * 3)))(x)
    assert "1 operations in 1 kernels; left to XLA" in caplog.text and "cumprod" in caplog.text
    assert operations(lambda x: x * 3, x) == (1, set())


def test_options_have_names():
    with pytest.raises(ValueError, match="compute must be one of auto, kernels, xla"):
        jd.PathTracer(compute="gpu")
