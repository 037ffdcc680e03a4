"""`[[compare]]`: runs of one config that differ in what it says, and their results side by side."""

import tomllib
from pathlib import Path

import pytest

from jaxdr import cli
from jaxdr.chart.config import chart_config
from jaxdr.optimize import phase
from jaxdr.optimize.compare import merged, variants
from jaxdr.optimize.config import optimize_config

from .fake import render

PAPERS = Path(__file__).resolve().parents[2] / "configs" / "papers"
CONFIG = """output = "out"
[target]
shape = "box"
size = 0.6
[initial]
subdivisions = 1
[cameras]
views = 2
resolution = 16
[integrator]
boundary = "KernelDensity"
[samples]
target = 4
pictures = 2
[optimizer]
iterations = 3
views_per_step = 1
[report]
chamfer = 1
chamfer_samples = 500
[[compare]]
label = "wide kernel"
[[compare]]
label = "a = none"
integrator = { boundary = "none" }
seed = 3
"""


@pytest.fixture(autouse=True)
def workplace(tmp_path, monkeypatch):
    (tmp_path / "run.toml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "_keep_programs", lambda options: None)
    monkeypatch.setattr(phase, "render", render)
    return tmp_path


def test_tables_are_merged_key_by_key():
    table = {"a": {"b": 1, "c": {"d": 2}}, "e": [1]}
    assert merged(table, {"a": {"c": {"f": 3}}, "e": [2]}) == {"a": {"b": 1, "c": {"d": 2, "f": 3}}, "e": [2]}
    assert table == {"a": {"b": 1, "c": {"d": 2}}, "e": [1]}


def test_variants_have_folders_of_their_own():
    table = {"output": "x", "seed": 1, "compare": [{"label": "A, b"}, {"label": "C", "seed": 2}]}
    one, two = variants(table, Path("run.toml"))
    assert one.table == {"output": str(Path("x/a_b")), "seed": 1} and one.folder == Path("x/a_b")
    assert two.table == {"output": str(Path("x/c")), "seed": 2} and two.label == "C"


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([], "compare: expected tables"),
        ([{"seed": 1}], "compare[0].label: expected a string"),
        ([{"label": "a"}, {"label": "A"}], "compare[1].label: labels must have letters or digits, and differ in them"),
        ([{"label": "a", "output": "y"}], "compare[0].output: is the same for all"),
    ],
)
def test_mistakes_name_the_key(entries, words):
    with pytest.raises(ValueError, match=r"run\.toml: ") as problem:
        variants({"output": "x", "compare": entries}, Path("run.toml"))
    assert words in str(problem.value)


def test_a_mistake_in_any_run_shows_before_the_first(capsys, workplace):
    text = (workplace / "run.toml").read_text().replace("seed = 3", "sed = 3")
    (workplace / "run.toml").write_text(text)
    assert cli.main(["optimize", "run.toml"]) == 2
    assert "sed: unknown key" in capsys.readouterr().err and not (workplace / "out").exists()


def test_all_runs_and_what_is_written(capsys):
    assert cli.main(["optimize", "run.toml"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[0] for line in shown] == ["wide kernel", "a = none"]
    for name in ("comparison.png", "comparison.csv", "meshes.png", "wide_kernel/metrics.json", "a_none/metrics.json"):
        assert (Path("out") / name).exists(), name
    header, *lines = Path("out/comparison.csv").read_text().splitlines()
    assert header == "label,steps,chamfer,seconds_a_step,seconds" and len(lines) == 2
    before = Path("out/a_none/metrics.csv").read_text()

    Path("out/wide_kernel/metrics.json").unlink()  # as if that run had been stopped
    assert cli.main(["optimize", "run.toml"]) == 2
    assert cli.main(["optimize", "run.toml", "--resume"]) == 0
    assert Path("out/a_none/metrics.csv").read_text() == before  # finished before: kept


@pytest.mark.parametrize("path", sorted(PAPERS.glob("*.toml")), ids=lambda path: path.stem)
def test_configs_of_the_papers(path):
    """They are valid, and say how they are run."""
    table, text = tomllib.loads(path.read_text()), path.read_text()
    assert f"{'chart' if 'scenes' in table else 'optimize'} configs/papers/{path.name}" in text
    assert table["output"] == f"runs/{path.stem}"
    if "scenes" in table:
        assert chart_config(table, path).scenes
        return
    found = [optimize_config(variant.table, path) for variant in variants(table, path)]
    assert len(found) > 1 and all(config.report.chamfer <= 4 for config in found)
