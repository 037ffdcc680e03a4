"""Files that appear whole or not at all."""

import errno
import os

import numpy as np
import pytest

from jaxdr.atomic_file import PARTIAL, CannotWrite, append_text, atomic_folder, atomic_path, remove_partial


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for name in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, name, full)
            with pytest.raises(CannotWrite, match=r"a\.txt: can't be written \(No space left on device\)") as caught:
                with atomic_path(path) as temporary:
                    temporary.write_text("new")
        assert caught.value.errno == errno.ENOSPC
    with pytest.raises(CannotWrite, match="No space left"), atomic_path(path):
        full()
    assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_the_contents_are_on_the_disk_before_the_name(tmp_path, monkeypatch):
    done = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda file: (done.append("fsync"), fsync(file)))
    monkeypatch.setattr(os, "replace", lambda *names: (done.append("replace"), replace(*names)))
    with atomic_path(tmp_path / "a.npz") as temporary:
        np.savez(temporary, x=1)
    assert done == ["fsync", "replace", "fsync"]  # the second one is of the folder


def test_a_folder_that_is_gone_is_named(tmp_path):
    with pytest.raises(CannotWrite, match=r"gone/a\.txt: can't be written \(No such file or directory\)"):
        with atomic_path(tmp_path / "gone" / "a.txt"):
            pass
    with pytest.raises(CannotWrite, match=r"gone/a\.csv: can't be written"):
        append_text(tmp_path / "gone" / "a.csv", "1,2\n")


def test_what_a_killed_process_left_is_removed(tmp_path):
    (tmp_path / "pictures").mkdir()
    (tmp_path / f"{PARTIAL}folder/inner").mkdir(parents=True)
    for path in (tmp_path / f"{PARTIAL}x.npz", tmp_path / "pictures" / f"{PARTIAL}y.png", tmp_path / "whole.png"):
        path.write_text("")
    remove_partial(tmp_path)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["pictures", "whole.png"]


def test_a_folder_appears_as_a_whole(tmp_path, monkeypatch):
    path, replace = tmp_path / "above/a", os.replace
    for content in ("old", "new"):
        with atomic_folder(path) as temporary:
            (temporary / "file").write_text(content)
    with pytest.raises(KeyError), atomic_folder(path) as temporary:
        raise KeyError

    def fail_for_new(source, target):
        if target == path and (source / "file").read_text() == "newest":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(source, target)

    monkeypatch.setattr(os, "replace", fail_for_new)
    with pytest.raises(CannotWrite, match="a: can't be written"), atomic_folder(path) as temporary:
        (temporary / "file").write_text("newest")
    assert (path / "file").read_text() == "new" and os.listdir(path.parent) == ["a"]
