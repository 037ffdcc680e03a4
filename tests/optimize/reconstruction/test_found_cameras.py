"""Photographs that come alone: cameras are found beside the output, once."""

import pytest

from jaxdr.optimize.reconstruction import found_cameras
from jaxdr.optimize.reconstruction.found_cameras import folder_with_cameras
from jaxdr.views.camera_folder import MARKER
from tests.views.folders import write_colmap, write_picture


@pytest.fixture
def asked(monkeypatch):
    """What cameras were looked for; nothing is."""
    asked = []

    def find(photos, output, seed, overwrite):
        asked.append((photos, output, seed, overwrite))
        output.mkdir(exist_ok=True)
        (output / MARKER).write_text("{}")

    monkeypatch.setattr(found_cameras, "find_cameras_with_bars", find)
    monkeypatch.setattr(found_cameras, "report", lambda registration: ["3 of 3 photographs registered"])
    return asked


def test_a_folder_with_cameras_stays(tmp_path, asked):
    said: list[str] = []
    folder = write_colmap(tmp_path / "photos")
    assert folder_with_cameras(folder, tmp_path / "out", 0, False, said.append) == folder
    assert folder_with_cameras(tmp_path / "nothing", tmp_path / "out", 0, False, said.append) == tmp_path / "nothing"
    assert not asked and not said


def test_cameras_are_found_once_and_again_with_overwrite(tmp_path, asked):
    said: list[str] = []
    photos, output = tmp_path / "photos", tmp_path / "out"
    for i in range(3):
        write_picture(photos / f"{i}.png", alpha=False)
    for _ in range(2):
        assert folder_with_cameras(photos, output, 5, False, said.append) == tmp_path / "out-cameras"
    assert asked == [(photos, tmp_path / "out-cameras", 5, False)]
    assert "has no cameras; they are looked for now" in said[0] and "3 of 3 photographs" in said[1]
    assert "those in" in said[2] and len(said) == 3
    folder_with_cameras(photos, output, 5, True, said.append)
    assert asked[1:] == [(photos, tmp_path / "out-cameras", 5, True)]
