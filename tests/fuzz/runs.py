"""Folders of runs that go on, and configs."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxdr.integrators import PathTracer
from jaxdr.optimize.checkpoint import Place
from jaxdr.optimize.config import Integrator, OptimizeConfig, Target, read_config
from jaxdr.optimize.output import RunFolder
from jaxdr.plan.report import Plan
from tests.fuzz.kind import Kind

QUICKSTART = Path(__file__).parents[2] / "configs" / "quickstart.toml"


def config(folder: Path) -> OptimizeConfig:
    """The config of the run in a folder. What it says of the folder's place does not count."""
    target = Target(shape="sphere", parameters={"subdivisions": 1})
    return OptimizeConfig(output=str(folder / "run"), target=target, integrator=Integrator(boundary="plan"))


def write_run(folder: Path) -> None:
    """A run that was stopped after two steps."""
    files = RunFolder(config(folder))
    with files.opened(resume=False, overwrite=False):
        files.save_targets(np.ones((2, 4, 4, 3), np.float32))
        files.save_plan(Plan(PathTracer(2), 8, ("depth: 2",), {"seconds": 1.0}))
        place = Place(2, 1.5, vertices=np.eye(3), faces=np.arange(3)[None])
        files.save_checkpoint(place, {"latent": jnp.ones((3, 3))})
        files.start_metrics(0)
        for step in (1, 2):
            files.add_metrics({"iteration": step, "loss": 0.5, "seconds": 1.0})


def read_run(folder: Path) -> None:
    """What a run that goes on reads before its first step."""
    files = RunFolder(config(folder))
    with files.opened(resume=True, overwrite=False):
        saved = files.load_checkpoint()
        if saved is not None:
            saved.state({"latent": jnp.ones((3, 3))})
        files.load_targets()
        files.load_plan([])
        files.start_metrics(2)


def kinds() -> list[Kind]:
    """A config, and a folder of results."""

    def write_config(folder: Path) -> None:
        (folder / "run.toml").write_text(QUICKSTART.read_text())

    return [
        Kind("toml", write_config, lambda folder: read_config(folder / "run.toml"), text=True),
        Kind("run", write_run, read_run, ("*.npz", "*.npy")),
        Kind("run_texts", write_run, read_run, ("*.json", "*.csv"), text=True),
    ]
