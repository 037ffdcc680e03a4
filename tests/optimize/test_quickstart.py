"""The quickstart for real, cut short: the renderer, its derivative and the loop together find the way."""

import json
from pathlib import Path

from jaxdr import cli

CONFIG = Path(__file__).resolve().parents[2] / "configs/quickstart.toml"


def test_the_first_steps_nearly_halve_the_distance(tmp_path):
    short = [
        "optimizer.iterations=30",
        "optimizer.final_learning_rate=0.1",
        "cameras.resolution=48",
        "samples.target=32",
    ]
    overrides = [part for text in (*short, f"output={tmp_path / 'run'}") for part in ("--set", text)]
    assert cli.main(["optimize", str(CONFIG), *overrides]) == 0
    summary = json.loads((tmp_path / "run/metrics.json").read_text())
    assert summary["chamfer_ratio"] > 1.8
    assert (tmp_path / "run/meshes/result.glb").stat().st_size > 10_000
    assert (tmp_path / "run/pictures/00030.png").stat().st_size > 10_000
