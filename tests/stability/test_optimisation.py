"""On the way to a shape: drift at the optimum, meshes that fold, remeshing of open and seamed ones."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.optimize import phase
from jaxdr.optimize.folds import folded_share
from jaxdr.optimize.shape import optimize
from tests.optimize.fake import render as fake_render
from tests.optimize.test_loop import small_config
from tests.stability.stage import cube, table

KEY = jax.random.key(6)


@pytest.fixture
def remeshing():
    return pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install -e ".[remesh]"')


@pytest.mark.slow
@pytest.mark.parametrize("boundary", [jd.LineSampling(), jd.KernelDensity()], ids=lambda b: type(b).__name__)
def test_nothing_drifts_at_the_optimum(boundary):
    """There the two-key loss and its gradient are zero but for noise: mean over many keys, every vertex coordinate."""
    scene, keys = table(cube()), 64
    rest = scene.parameters()["blocker.vertices"]
    plain, method = jd.PathTracer(2, None), jd.PathTracer(2, boundary)
    target = jnp.mean(jnp.stack([jd.render(scene, k, 1024, plain) for k in jax.random.split(KEY, 8)]), 0)

    @jax.jit
    def gradient(vertices, key):
        def loss(v):
            moved = scene.replace({"blocker.vertices": v})
            images = [jd.render(moved, k, 16, method) for k in jax.random.split(key)]
            return jd.losses.two_key_l2(*images, target)

        return jax.grad(loss)(vertices)

    rows = np.stack([gradient(rest, k) for k in jax.random.split(jax.random.key(7), keys)]).astype(float)
    z = rows.mean(0) / (rows.std(0, ddof=1) / np.sqrt(keys))
    assert np.abs(z).max() < 4.5, z
    assert np.mean(z**2) < 2.0, z  # 24 numbers, one each where nothing drifts
    # For comparison: a hundredth of the cube's size away it is no noise.
    away = np.stack([gradient(rest + 0.02, k) for k in jax.random.split(jax.random.key(8), keys)]).astype(float)
    assert np.abs(away.mean(0) / (away.std(0, ddof=1) / np.sqrt(keys))).max() > 6


def kicked(scene, key, spp, integrator):
    """The stand-in for a renderer, with derivatives that push every vertex another way in every call."""
    vertices = scene.shapes["object"].mesh.vertices
    moved = vertices - jax.lax.stop_gradient(vertices)
    kick = (jax.random.normal(jax.random.fold_in(key, 1), vertices.shape) * moved).sum()
    return fake_render(scene, key, spp, integrator) + 0.5 * kick


@pytest.mark.parametrize("lam", [19.0, 0.0])
def test_a_collapse_is_reported(lam, tmp_path, monkeypatch, capsys):
    """With noisy gradients and large steps: the preconditioner keeps the surface whole, without it the run says so."""
    monkeypatch.setattr(phase, "render", kicked)
    config = small_config(tmp_path / "run")
    options = dataclasses.replace(config.optimizer, iterations=24, lam=lam, learning_rate=0.05)
    summary = optimize(dataclasses.replace(config, optimizer=options))
    share = folded_share(jd.load_mesh(f"{config.output}/meshes/result.glb"))
    said = capsys.readouterr().err.count("the mesh is collapsing")
    assert summary["folded"] == pytest.approx(share, abs=0.01)
    assert (share < 0.01 and said == 0) if lam else (share > 0.1 and said == 1), (share, said)


def test_remeshing_an_open_mesh_keeps_its_border(remeshing):
    """A square stays a flat square, and open."""
    plane = shapes.plane(2.0, 8)
    result = jd.remesh(plane, 0.15)
    points = np.asarray(result.vertices)
    edges = np.asarray(result.edges.vertices)[np.asarray(result.edges.kind) == 1]
    a, b = points[edges].transpose(1, 0, 2)
    assert not result.closed
    assert np.abs(points[:, 2]).max() < 1e-6
    assert np.abs(np.abs((a + b) / 2).max(1) - 1.0).max() < 1e-6, "the border has moved"
    np.testing.assert_allclose(np.linalg.norm(a - b, axis=1).sum(), 8.0, rtol=1e-5)


def test_remeshing_a_seamed_mesh_opens_no_seam(remeshing):
    """UVs are indexed separately, so that a seam is no border: the box stays closed. Its UVs are dropped."""
    box = shapes.box()
    assert box.uvs is not None and box.closed
    result = jd.remesh(box, 0.2)
    assert result.closed and result.uvs is None
    assert jd.chamfer(result, box) < 0.02


def test_remeshing_split_vertices_keeps_the_seam_shut(remeshing, recwarn):
    """A sphere cut into two halves that share no vertices: what was on one another still is."""
    ball = shapes.sphere(3)
    upper = np.asarray(ball.vertices)[np.asarray(ball.faces)].mean(1)[:, 2] > 0
    count = len(ball.vertices)
    faces = np.asarray(ball.faces) + np.where(upper, count, 0)[:, None]
    split = jd.Mesh(np.vstack([ball.vertices, ball.vertices]), faces)
    assert any("lie on others without sharing vertices" in str(w.message) for w in recwarn)
    assert not split.closed
    result = jd.remesh(split, 0.15)
    points, edges = np.asarray(result.vertices), result.edges
    rim = points[np.unique(np.asarray(edges.vertices)[np.asarray(edges.kind) == 1])]
    nearest = np.sort(np.linalg.norm(rim[:, None] - rim, axis=-1), axis=1)[:, 1]
    assert nearest.max() < 1e-5, "the halves have come apart"
