"""Runs whose integrator is left to a plan: it is made once, kept, told, and taken again."""

import dataclasses
import json

import numpy as np
import pytest

import jaxdr as jd
from jaxdr.optimize import phase, planned, shape
from jaxdr.optimize.config import Cameras, Initial, Integrator, OptimizeConfig, Optimizer, Report, Samples, Target
from jaxdr.optimize.config import read_config as read
from jaxdr.optimize.shape import optimize
from jaxdr.plan.report import Plan

from .fake import render as fake_render

PLAN = Plan(jd.PathTracer(4, jd.LineSampling(chords=2.0)), 4, ("depth: 4", "estimator: LineSampling"), {"a": [1.5]})


PLANNED = Integrator(max_depth="plan", boundary="plan")


@pytest.fixture
def asked(monkeypatch):
    """Plans that are asked for, integrators that are rendered with."""
    found = {"plans": [], "integrators": set()}

    def plan(scene, params, **options):
        found["plans"].append({"scene": scene, "params": params, **options})
        return PLAN

    def render(scene, key, spp, integrator):
        found["integrators"].add(integrator)
        return fake_render(scene, key, spp, integrator)

    monkeypatch.setattr(planned, "plan", plan)
    monkeypatch.setattr(phase, "render", render)
    return found


def config(output, integrator=PLANNED, iterations=2):
    return OptimizeConfig(
        output=str(output),
        target=Target(shape="sphere", parameters={"subdivisions": 1}, size=0.9),
        initial=Initial(subdivisions=1, radius=0.3),
        cameras=Cameras(views=2, resolution=8),
        integrator=integrator,
        samples=Samples(target=4, image=2, gradient=3, pictures=2),
        optimizer=Optimizer(iterations=iterations, views_per_step=1),
        report=Report(pictures=5, chamfer=5, checkpoint=1, views=1, chamfer_samples=100),
    )


def test_a_plan_is_made_told_and_kept(asked, tmp_path, capsys):
    summary = optimize(config(tmp_path / "run"))
    (plan,) = asked["plans"]
    assert plan["params"] == ["object.vertices"] and plan["spp"] == 3
    assert plan["max_depth"] is None and plan["boundary"] == "auto"
    assert asked["integrators"] == {PLAN.integrator}
    assert "jaxdr: plan: estimator: LineSampling" in capsys.readouterr().err
    assert summary["plan"] == PLAN.to_dict()
    assert Plan.from_dict(json.loads((tmp_path / "run" / "metrics.json").read_text())["plan"]) == PLAN


def test_a_resumed_run_measures_nothing(asked, tmp_path, monkeypatch):
    once = config(tmp_path / "run", iterations=4)
    optimize(config(tmp_path / "straight", iterations=4))

    original = shape.RunFolder.add_metrics

    def stop(self, row):
        original(self, row)
        if row["iteration"] == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(shape.RunFolder, "add_metrics", stop)
        with pytest.raises(KeyboardInterrupt):
            optimize(once)
    asked["plans"].clear()
    optimize(once, resume=True)
    assert asked["plans"] == [] and asked["integrators"] == {PLAN.integrator}
    latents = [np.load(tmp_path / name / "checkpoint.npz")["state/latent"] for name in ("run", "straight")]
    np.testing.assert_array_equal(*latents)
    (tmp_path / "run" / "metrics.json").unlink()
    (tmp_path / "run" / "plan.json").write_text("{")
    with pytest.raises(ValueError, match=r"plan\.json: is not readable JSON.*--overwrite"):
        optimize(once, resume=True)


def test_an_integrator_that_is_named_is_not_planned(asked, tmp_path):
    summary = optimize(config(tmp_path / "run", Integrator()))
    assert asked["plans"] == [] and "plan" not in summary
    assert asked["integrators"] == {jd.PathTracer(2)} and not (tmp_path / "run" / "plan.json").exists()


def test_what_is_named_is_kept(asked, tmp_path):
    optimize(config(tmp_path / "one", Integrator(max_depth=3, boundary="plan")))
    options = {"radius": 0.05}
    optimize(config(tmp_path / "two", Integrator("plan", boundary="KernelDensity", boundary_options=options)))
    one, two = asked["plans"]
    assert one["max_depth"] == 3 and one["boundary"] == "auto"
    assert two["max_depth"] is None and two["boundary"] == jd.KernelDensity(0.05)


MINIMAL = 'output = "runs/x"\n[target]\nshape = "pawn"\n'


def test_configs(tmp_path):
    """A file that says nothing of the integrator leaves it to a plan; one that says anything has the old defaults."""
    file = tmp_path / "run.toml"
    file.write_text(MINIMAL)
    assert read(file).integrator == PLANNED and read(file).integrator.planned
    assert read(file, ["integrator.max_depth=2"]).integrator == Integrator()
    half = read(file, ["integrator.max_depth=plan"]).integrator
    assert half.planned and half.estimator() == "auto"
    for overrides, message in (
        (["integrator.boundary=plan", "integrator.max_depth=0"], "max_depth: must be at least 1"),
        (["integrator.boundary=plan", "integrator.primary=material"], "primary: must be 'fixed_ray'"),
        (["integrator.boundary=plan", "integrator.boundary_options.radius=1"], 'boundary "plan" has none'),
        (["integrator.max_depth=deep"], r"max_depth: expected an integer or one of 'plan'"),
        (["integrator.max_depth=plan", "integrator.boundary_options.radius=0.0"], 'boundary "auto" has none'),
    ):
        with pytest.raises(ValueError, match=message):
            read(file, overrides)
    assert dataclasses.replace(read(file), integrator=Integrator()).integrator.build() == jd.PathTracer(2)
