"""`jaxdr chart` from the command line: a stand-in for the renderer, whose errors are known; once the real one."""

import csv
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr import cli
from jaxdr.chart import measure, reference, scene_run

from .test_chart_config import MINIMAL

SPREAD = 0.5  # relative noise of the stand-in at one sample per pixel
BIAS = 0.3  # of its kernel estimator
SETTINGS = ["keys=8", "samples=[1, 16]", "memory=false", "terms=4"]
VERTICES = "vertices={reference='LineSampling', target=0.2, image_samples=4096, samples=64, batches=4}"


def image_of(scene, key, spp, boundary):
    """A pattern times the mean x of the vertices; its derivative by a translation is the pattern."""
    film = scene.camera.film
    x = scene.shapes["ball"].mesh.vertices[:, 0].mean()
    if isinstance(boundary, jd.KernelDensity):
        x = x + BIAS * (x - jax.lax.stop_gradient(x))
    noise = 1 + SPREAD * jax.random.normal(key, (film.height, film.width, 3)) / spp**0.5
    return jnp.linspace(1.0, 2.0, film.width)[None, :, None] * x * noise


@pytest.fixture
def asked(monkeypatch):
    """How often each program was traced."""
    counts = []

    def render(scene, key, spp, integrator):
        counts.append(spp)
        return image_of(scene, key, spp, integrator.boundary)

    def derivative_terms(scene, key, spp, integrator, moving):
        assert moving.shapes == (True, False, False)
        image = image_of(scene, key, spp, integrator.boundary)
        return {"interior": image, "boundary": 0 * image}

    for module in (measure, reference):
        monkeypatch.setattr(module, "render", render)
    monkeypatch.setattr(measure, "derivative_terms", derivative_terms)
    return counts


@pytest.fixture(autouse=True)
def workplace(tmp_path, monkeypatch):
    (tmp_path / "chart.toml").write_text(MINIMAL)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*options, settings=SETTINGS):
    arguments = [word for setting in settings for word in ("--set", setting)]
    return cli.main(["chart", "chart.toml", *arguments, *options])


def rows(name="rows"):
    with open(f"out/{name}.csv", newline="") as file:
        return list(csv.DictReader(file))


def steady(table):
    """What is no time."""
    return [{k: v for k, v in row.items() if "seconds" not in k and k not in ("work", "pareto")} for row in table]


def test_rows_against_the_closed_form(asked, capsys):
    assert run(settings=[*SETTINGS, VERTICES]) == 0
    assert capsys.readouterr().out == "out/index.html: 4 points, 0 over the budget, 0 refused\n"
    table = rows()
    assert [(r["estimator"], r["samples"]) for r in table] == [
        (name, n) for name in ("LineSampling", "KernelDensity, radius=0.1") for n in ("1", "16")
    ]
    for row in table:
        kernel = row["estimator"].startswith("Kernel")
        scale, spp = (1 + BIAS if kernel else 1), int(row["samples"])
        value = {k: float(row[k]) for k in ("rmse", "deviation", "projection", "projection_error", "noise", "bias")}
        assert value["deviation"] == pytest.approx(scale * SPREAD / spp**0.5, rel=0.1)
        assert value["noise"] == pytest.approx(SPREAD / (256 * 16) ** 0.5, rel=0.1)
        assert abs(value["projection"] - scale) < 4 * value["projection_error"]
        if kernel:
            assert value["bias"] == pytest.approx(BIAS, rel=0.25)
        elif spp == 16:
            assert value["bias"] < 2 * float(row["bias_resolution"])
        assert row["status"] == "ok" and row["calls"] == "8" and float(row["compile_seconds"]) > 0
        assert float(row["vertex_rmse"]) > 0 and float(row["vertex_seconds"]) > 0
    assert any(row["pareto"] == "true" for row in table)
    for row in rows("terms"):
        expected = SPREAD / 2 * (1.3 if row["estimator"].startswith("Kernel") else 1) * (row["term"] == "interior")
        assert float(row["deviation"]) == pytest.approx(expected, rel=0.1)
    page = Path("out/index.html").read_text()
    assert page.count("data:image/png;base64,") == 2 + 1 + 2 * 2 and "src='http" not in page
    assert "standard errors" in page
    for name in ("ball", "ball_vertices", "ball_images", "ball_vertices_map"):
        assert Path(f"out/{name}.png").exists(), name


def test_gradient_of_the_sum_by_vertices(asked):
    """The stand-in's image is a pattern times the mean x: the sum's gradient by any vertex is the same, along x."""
    vertices = "vertices={reference='LineSampling', residual='ones', samples=64, batches=4}"
    assert run(settings=[*SETTINGS, vertices, "estimators=[{boundary='LineSampling'}]"]) == 0
    found = np.load("out/references/ball/vertices_0.npy")
    pattern = 3 * 8 * np.linspace(1.0, 2.0, 8).sum()
    np.testing.assert_allclose(found[:, 0], pattern / len(found), rtol=0.02)
    assert not found[:, 1:].any()


def test_resume_gives_the_same_rows(asked, capsys, monkeypatch):
    assert run() == 0
    whole, terms = rows(), rows("terms")
    assert run() == 2 and "already holds results" in capsys.readouterr().err
    assert run("--resume", settings=[*SETTINGS, "seed=1"]) == 2 and "differs from the chart's: seed was" in (
        capsys.readouterr().err
    )
    asked.clear()
    assert run("--resume") == 0
    assert rows() == whole and rows("terms") == terms and not asked  # times too: nothing was measured again

    picture = Path("out/ball.png").read_bytes()
    assert run("--resume", settings=[*SETTINGS, "until=9.0"]) == 0  # what pictures show may change
    assert rows() == whole and not asked and Path("out/ball.png").read_bytes() != picture

    assert run("--overwrite") == 0
    assert steady(rows()) == steady(whole)


def test_interruption_keeps_what_was_measured(asked, capsys, monkeypatch):
    """Ctrl-C after five calls: the chart stops before the next one and says how to go on."""
    runs, made = [], []
    start, save = scene_run.SceneRun.measure, scene_run.ChartFolder.save_call

    def measured(self):
        runs.append(self)
        start(self)

    def save_call(self, cell, number, values, kind="calls"):
        save(self, cell, number, values, kind)
        made.append(number)
        runs[0].stop.requested = len(made) == 5

    monkeypatch.setattr(scene_run.SceneRun, "measure", measured)
    monkeypatch.setattr(scene_run.ChartFolder, "save_call", save_call)
    assert run(settings=[*SETTINGS, "samples=[1]"]) == cli.INTERRUPTED
    assert "jaxdr chart chart.toml --set keys=8" in capsys.readouterr().err
    assert len(list(Path("out/calls/ball").iterdir())) == 5 and not Path("out/rows.csv").exists()


def test_interrupted_chart_goes_on(asked, workplace):
    """Calls that are gone are made again, the same but for their times."""
    assert run() == 0
    whole = rows()
    for path in sorted(Path("out/calls/ball").iterdir())[::3]:
        path.unlink()
    Path("out/references/ball/image_3.npy").unlink()
    assert run("--resume") == 0
    assert steady(rows()) == steady(whole)


def test_budget_refusal_and_values_that_are_not_finite(asked, monkeypatch, capsys):
    def render(scene, key, spp, integrator):
        if integrator.boundary is not None and isinstance(integrator.boundary, jd.KernelDensity):
            raise ValueError("render: this scene is too hard\nreally")
        image = image_of(scene, key, spp, integrator.boundary)
        return image.at[0, 0].divide(0.0) if spp == 16 else image

    monkeypatch.setattr(measure, "render", render)
    assert run(settings=[*SETTINGS, "terms=0"]) == cli.FAILED
    assert "not finite: ball, LineSampling, 16 spp" in capsys.readouterr().err
    table = rows()
    assert [row["status"] for row in table] == ["ok", "not finite: 8 of 8 images"] + 2 * [
        "refused: render: this scene is too hard"
    ]
    assert table[1]["rmse"] == "" and table[1]["seconds"] != ""
    monkeypatch.setattr(measure, "render", lambda scene, key, spp, integrator: image_of(scene, key, spp, None))
    assert run("--overwrite", settings=[*SETTINGS, "terms=0", "budget=1e-9"]) == 0
    assert all(row["status"].startswith("over budget") for row in rows())


def test_missing_packages_are_named(monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert run() == 2
    assert 'pip install -e ".[experiments]"' in capsys.readouterr().err
    assert not Path("out").exists()


def test_the_real_renderer():
    """Interior term alone: of a ball with its shadow it has nearly nothing."""
    text = MINIMAL.replace("step = 0.02", "step = 0.05, samples = 64, batches = 4")
    text = text[: text.index("[[estimators]]")] + '[[estimators]]\nboundary = "none"\n'
    Path("chart.toml").write_text(text)
    assert run(settings=["keys=8", "samples=[2]", "memory=false", "terms=0"]) == 0
    (row,) = rows()
    assert float(row["bias"]) > 3 * float(row["bias_resolution"]) and row["resolved"] == "true"
    assert float(row["seconds"]) > 0 and float(row["program_mb"]) > 0
