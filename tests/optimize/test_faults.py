"""Full disks and folders that vanish: what is said, and that the last checkpoint stays whole."""

import errno
import os
import shutil
import signal

import numpy as np
import pytest

from jaxdr import atomic_file
from jaxdr.optimize import phase, shape
from jaxdr.optimize.checkpoint import load_checkpoint
from jaxdr.optimize.progress import Interrupted, Stopped
from jaxdr.optimize.shape import optimize

from .fake import render as fake_render
from .test_loop import checkpoint, rows, small_config


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.setattr(phase, "render", fake_render)
    return small_config(tmp_path / "run")


def full_from(monkeypatch, step, names):
    """A disk that is full, for files whose names end so, once so many steps are recorded."""
    done, replace, add_metrics = [], os.replace, shape.RunFolder.add_metrics

    def add(self, row):
        add_metrics(self, row)
        done.append(row["iteration"])

    def full(source, target):
        if str(target).endswith(names) and done and done[-1] >= step:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(source, target)

    monkeypatch.setattr(shape.RunFolder, "add_metrics", add)
    monkeypatch.setattr(atomic_file.os, "replace", full)


def test_a_checkpoint_that_cannot_be_written_ends_the_run_and_the_last_one_is_whole(config, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        full_from(patch, 4, "checkpoint.npz")
        with pytest.raises(Stopped) as caught:
            optimize(config)
    message = str(caught.value)
    assert "checkpoint.npz: can't be written (No space left on device)" in message and "\n" not in message
    assert "the checkpoint of step 2 in" in message and "is whole" in message
    assert checkpoint(config)["step"] == 2
    optimize(config, resume=True)
    straight = small_config(tmp_path / "straight")
    optimize(straight)
    for name, value in checkpoint(straight).items():
        np.testing.assert_array_equal(value, checkpoint(config)[name], err_msg=name)


def test_a_result_that_cannot_be_written_ends_the_run(config, monkeypatch):
    full_from(monkeypatch, 6, "result.glb")
    with pytest.raises(Stopped, match=r"result\.glb: can't be written .*the checkpoint of step 6"):
        optimize(config)


def test_a_picture_that_cannot_be_written_is_said_and_survived(config, tmp_path, monkeypatch, capsys):
    full_from(monkeypatch, 3, ".png")
    optimize(config)
    said = capsys.readouterr().err
    for step in (3, 6):
        assert f"after step {step}: {tmp_path}/run/pictures/{step:05d}.png: can't be written (No space left" in said
    assert said.count("the run goes on without it") == 2 and len(rows(config)) == 6


def test_a_folder_that_vanishes_is_told(config, tmp_path, monkeypatch):
    add_metrics = shape.RunFolder.add_metrics

    def vanish(self, row):
        add_metrics(self, row)
        if row["iteration"] == 2:
            shutil.rmtree(self.path)

    monkeypatch.setattr(shape.RunFolder, "add_metrics", vanish)
    with pytest.raises(Stopped, match=r"No such file or directory.*run is gone, and its checkpoint with it"):
        optimize(config)


def test_a_checkpoint_that_was_lost_is_told(config, tmp_path, monkeypatch):
    optimize(config)
    (tmp_path / "run/metrics.json").unlink()
    (tmp_path / "run/checkpoint.npz").unlink()
    with pytest.raises(ValueError, match=r"there is no checkpoint to resume from, though 6 steps are done"):
        optimize(config, resume=True)


def test_half_a_line_of_metrics_is_dropped(config, tmp_path, monkeypatch):
    def stop(self, *arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(shape.ShapeTask, "finish", stop)
        with pytest.raises(KeyboardInterrupt):
            optimize(config)
    path = tmp_path / "run/metrics.csv"
    for left in ("7", "7,0.1\n", "\n"):
        before = path.read_text()
        path.write_text(before + left)
        shape.RunFolder(config).start_metrics(6)
        assert path.read_text() == before


def test_sigterm_is_like_ctrl_c(config, monkeypatch):
    add_metrics = shape.RunFolder.add_metrics

    def terminate(self, row):
        add_metrics(self, row)
        if row["iteration"] == 3:
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(shape.RunFolder, "add_metrics", terminate)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Interrupted, match="stopped after step 3"):
        optimize(config)
    assert signal.getsignal(signal.SIGTERM) == before
    folder = shape.RunFolder(config)
    assert load_checkpoint(folder.checkpoint, folder.owner).place.step == 3


def test_a_folder_of_another_kind_of_run_is_told(config, tmp_path):
    optimize(config)
    folder = shape.RunFolder(config)
    folder.kind = "recovery"
    with pytest.raises(ValueError, match=r"holds a shape optimisation, this is a recovery; choose another output"):
        with folder.opened(resume=True, overwrite=False):
            pass
