"""Folders of results: nothing of others is deleted, one run at a time, inputs are remembered, code is not run."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from jaxdr.optimize import phase
from jaxdr.optimize.config import Integrator
from jaxdr.optimize.output import RunFolder
from jaxdr.optimize.results_folder import LOCK, MARKER, Results, files_of, results_folder
from jaxdr.optimize.shape import optimize

from .fake import render as fake_render
from .test_loop import small_config


@dataclasses.dataclass(frozen=True)
class Config:
    seed: int = 0
    path: str = ""


def results(path: Path, inputs=None, config=None, kind="trial") -> Results:
    return Results(
        path, kind, config or Config(), "config.json", (), (MARKER, "loss.csv", "pictures/0*.png"), inputs or {}
    )


def use(folder: Results, resume=False, overwrite=False) -> None:
    """A run that writes two files."""
    with results_folder(folder, resume, overwrite):
        (folder.path / "pictures").mkdir(exist_ok=True)
        (folder.path / "pictures" / "00000.png").write_text("picture")
        (folder.path / "loss.csv").write_text("loss")


def files(path: Path) -> set[str]:
    return {p.relative_to(path).as_posix() for p in path.rglob("*") if p.is_file() and p.name != LOCK}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_with_a_config_of_others_is_left_alone(tmp_path, overwrite):
    web = tmp_path / "web"
    web.mkdir()
    (web / "config.json").write_text("{}")
    (web / "thesis.tex").write_text("all of it")
    with pytest.raises(ValueError, match=r"not the folder of a trial \(it has no jaxdr.json\)"):
        use(results(web), overwrite=overwrite)
    assert files(web) == {"config.json", "thesis.tex"} and not (web / LOCK).exists()


def test_overwrite_deletes_what_a_run_writes_and_nothing_else(tmp_path):
    out = tmp_path / "out"
    use(results(out))
    (out / "notes.txt").write_text("mine")
    (out / "pictures" / "holiday.png").write_text("mine")
    (out / "pictures" / "00007.png").write_text("an earlier run's")
    use(results(out, config=Config(seed=1)), overwrite=True)
    own = {MARKER, "config.json", "loss.csv", "pictures/00000.png"}
    assert files(out) == own | {"notes.txt", "pictures/holiday.png"}
    assert json.loads((out / "config.json").read_text())["seed"] == 1


def test_links_are_not_followed(tmp_path):
    out, album = tmp_path / "out", tmp_path / "album"
    use(results(out))
    album.mkdir()
    for name in ("00000.png", "00001.png"):
        (album / name).write_text("mine")
    (out / "pictures" / "00000.png").unlink()
    (out / "pictures").rmdir()
    (out / "pictures").symlink_to(album)
    (out / "loss.csv").unlink()
    (out / "loss.csv").symlink_to(album / "00000.png")
    with results_folder(results(out), False, True):
        pass
    assert files(album) == {"00000.png", "00001.png"} and not (out / "loss.csv").is_symlink()


@pytest.mark.parametrize("out", ["photos", "photos/out", "."])
def test_the_output_is_apart_from_the_input(tmp_path, out):
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "one.png").write_text("picture")
    for overwrite in (False, True):
        with pytest.raises(ValueError, match=r"output .*: (is|lies in|holds) the input .*photos; choose another"):
            use(results(tmp_path / out, {"photographs": photos}), overwrite=overwrite)
    assert files(tmp_path) == {"photos/one.png"}


def test_an_input_file_in_the_output_is_refused(tmp_path):
    use(results(tmp_path))
    mesh = tmp_path / "loss.csv"
    with pytest.raises(ValueError, match=r"holds the input .*loss.csv"):
        use(results(tmp_path, {"mesh": mesh}), overwrite=True)
    assert mesh.exists()


def test_one_run_at_a_time(tmp_path):
    folder = results(tmp_path / "out")
    with results_folder(folder, False, False):
        for resume, overwrite in ((False, True), (True, False)):
            with pytest.raises(ValueError, match="another run is at work there"):
                use(folder, resume, overwrite)
    use(folder, overwrite=True)


HOLDS = """
import sys
from pathlib import Path
from tests.optimize.test_results_folder import results
from jaxdr.optimize.results_folder import results_folder
with results_folder(results(Path(sys.argv[1])), False, False):
    print("there", flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_killed_run_leaves_the_folder_free(tmp_path):
    folder = results(tmp_path / "out")
    command = [sys.executable, "-c", HOLDS, str(folder.path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "there\n"
        with pytest.raises(ValueError, match="another run is at work there"):
            use(folder, resume=True)
        other.send_signal(signal.SIGKILL)
    use(folder, resume=True)


def test_a_start_that_was_cut_can_be_started_again(tmp_path):
    folder = results(tmp_path / "out")
    use(folder)
    (folder.path / "config.json").unlink()
    (folder.path / "loss.csv").unlink()
    with pytest.raises(ValueError, match="there is no trial to resume"):
        use(folder, resume=True)
    use(folder)
    with pytest.raises(ValueError, match="already holds results"):
        use(folder)


def test_inputs_are_remembered_by_their_contents(tmp_path):
    photo = tmp_path / "photos" / "one.png"
    photo.parent.mkdir()
    photo.write_text("picture")
    folder = results(tmp_path / "out", {"photographs": photo.parent, "one.png": photo})
    use(folder)
    use(folder, resume=True)
    photo.write_text("another")  # of the same size
    with pytest.raises(ValueError, match=r"one\.png: has other contents than when the run began"):
        use(folder, resume=True)
    photo.unlink()
    with pytest.raises(ValueError, match=r"one\.png: was read when the run began, and is missing now"):
        use(folder, resume=True)
    photo.write_text("picture")
    use(folder, resume=True)


def test_results_without_a_marker_go_on_and_get_one(tmp_path):
    """An older version wrote none."""
    folder = results(tmp_path / "out")
    use(folder)
    (folder.path / MARKER).unlink()
    with pytest.raises(ValueError, match="results of an older version are not deleted: delete them yourself"):
        use(folder, overwrite=True)
    use(folder, resume=True)
    use(folder, overwrite=True)


@pytest.mark.parametrize(
    "name, content, words",
    [
        (MARKER, "{", "is not readable JSON"),
        (MARKER, "[]", "is not the marker of a folder of results"),
        (MARKER, '{"jaxdr": "results", "kind": "trial", "version": 99, "inputs": {}}', "of another version of jaxdr"),
        (MARKER, '{"jaxdr": "results", "kind": "chart", "version": 1, "inputs": {}}', "holds a chart, this is a trial"),
        ("config.json", "[]", "is damaged"),
        ("config.json", b"\xff\xfe", "is not readable JSON"),
        ("config.json", "[" * 5000, "nested too deeply"),
    ],
)
def test_damaged_markers_and_configs(tmp_path, name, content, words):
    folder = results(tmp_path / "out")
    use(folder)
    (folder.path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    before = {path: (folder.path / path).read_bytes() for path in files(folder.path)}
    with pytest.raises(ValueError, match=words) as caught:
        use(folder, resume=True)
    assert str(folder.path) in str(caught.value)
    assert before == {path: (folder.path / path).read_bytes() for path in files(folder.path)}


def test_files_that_a_config_names(tmp_path):
    config = small_config(tmp_path / "run")
    target = dataclasses.replace(config.target, shape="", parameters={}, path=str(tmp_path / "a.obj"))
    assert files_of(dataclasses.replace(config, target=target)) == {str(tmp_path / "a.obj"): tmp_path / "a.obj"}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """The folder of a run that was stopped in its last moment."""
    monkeypatch.setattr(phase, "render", fake_render)
    config = small_config(tmp_path / "run")
    optimize(config)
    (tmp_path / "run" / "metrics.json").unlink()
    return config


def changed(arrays: dict, **changes) -> dict:
    return {name: value for name, value in (arrays | changes).items() if value is not None}


@pytest.mark.parametrize(
    "change",
    [
        {"step": np.arange(3)},
        {"step": -1},
        {"step": 2.5},
        {"seconds": np.nan},
        {"config": "["},
        {"config": None},
        {"level": "one"},
        {"kind": np.zeros(3)},
    ],
)
def test_damaged_checkpoints(run, change):
    path = Path(run.output) / "checkpoint.npz"
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **changed(arrays, **change))
    with pytest.raises(ValueError, match=r"run/checkpoint\.npz"):
        optimize(run, resume=True)


def test_encrypted_and_cut_checkpoints(run):
    path = Path(run.output) / "checkpoint.npz"
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        start = archive.infolist()[0].header_offset
    data[start + 6] |= 1
    end = data.rindex(b"PK\x01\x02")
    data[end + 8] |= 1
    for content in (bytes(data), bytes(data[: len(data) // 2]), b""):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"checkpoint\.npz: is damaged"):
            optimize(run, resume=True)


@pytest.mark.parametrize(
    "name, content", [("targets.npy", b""), ("targets.npy", b"PK"), ("metrics.csv", b"iteration\n\xff\xfe,1\n")]
)
def test_other_damaged_files(run, name, content):
    (Path(run.output) / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"run/{name}.*start again with --overwrite"):
        optimize(run, resume=True)


def test_targets_of_another_shape(run):
    np.save(Path(run.output) / "targets.npy", np.zeros((0, 3)))
    with pytest.raises(ValueError, match=r"targets\.npy: expected numbers of shape"):
        optimize(run, resume=True)


@pytest.mark.parametrize("kind", ["mine.py:Mine", "os:getcwd", 3])
def test_code_is_not_run_because_a_folder_names_it(tmp_path, monkeypatch, kind):
    """A folder of results that somebody sends must not run a program when it goes on."""
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text("raise SystemExit('it ran')")
    folder = RunFolder(dataclasses.replace(small_config(tmp_path / "run"), integrator=Integrator(boundary="plan")))
    with folder.opened(False, False):
        for boundary in ({"kind": kind}, {"kind": "ByKind", "rest": {"kind": kind}}):
            estimator = {"kind": "PathTracer", "max_depth": 2, "boundary": boundary}
            folder.write_text("plan.json", json.dumps({"integrator": estimator, "spp": 1, "lines": [], "figures": {}}))
            with pytest.raises(ValueError, match="code is run only where a config names it"):
                folder.load_plan([])


@pytest.mark.parametrize("plan", ["[]", "{}", '{"integrator": 3}', '{"integrator": {"boundary": "KernelDensity"}}'])
def test_damaged_plans(tmp_path, plan):
    folder = RunFolder(small_config(tmp_path / "run"))
    with folder.opened(False, False):
        folder.write_text("plan.json", plan)
    with pytest.raises(ValueError, match=r"plan\.json: (is damaged|can't be read).*--overwrite"):
        folder.load_plan([])
