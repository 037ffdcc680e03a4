"""Cameras from photographs alone: which files count, what is refused, what is written, and whether it is right."""

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxdr import cli
from jaxdr.views import registration
from jaxdr.views.layouts.colmap_tables import read_tables
from jaxdr.views.load import load_views
from jaxdr.views.photographs import find_photographs
from jaxdr.views.registration import find_cameras, pairs, report

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
ROOT = Path(__file__).parents[2]
NUMBERS = {"error": 0.5, "points": 900, "focal": [300.0], "lens": "SIMPLE_RADIAL", "others": []}


def poses(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(rotation to the camera with y down and z ahead, centre) of cameras on an arc around a corner."""
    found = []
    for angle in np.linspace(0.25, 1.3, count):
        centre = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1.2 + 0.5 * np.sin(4 * angle)])
        ahead = np.array([0.4, 0.4, 0.4]) - centre
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0, 0, 1])
        right /= np.linalg.norm(right)
        found.append((np.stack([right, np.cross(ahead, right), ahead]), centre))
    return found


def photograph(rotation: np.ndarray, centre: np.ndarray, textures: np.ndarray) -> Image.Image:
    """A picture of the corner of three walls x = 0, y = 0, z = 0, each with a texture."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], -1) @ rotation
    with np.errstate(divide="ignore"):
        far = np.where(rays < 0, -centre / rays, np.inf)
    wall = far.argmin(-1)
    points = centre + rays * far.min(-1)[..., None]
    u, v = (np.take_along_axis(points, ((wall + i) % 3)[..., None], -1)[..., 0] for i in (1, 2))
    size = textures.shape[1]
    values = textures[wall, (u * 110).astype(int) % size, (v * 110).astype(int) % size]
    return Image.fromarray(values)


@pytest.fixture(scope="module")
def corner(tmp_path_factory) -> Path:
    """A folder of eight photographs of a corner, with spaces in their names."""
    folder = tmp_path_factory.mktemp("corner") / "photographs"
    folder.mkdir()
    random = np.random.default_rng(0)
    coarse = random.integers(0, 255, (3, 64, 64), np.uint8)
    textures = np.stack([np.asarray(Image.fromarray(c).resize((512, 512), Image.Resampling.BICUBIC)) for c in coarse])
    for i, pose in enumerate(poses(8)):
        photograph(*pose, textures).save(folder / f"a photo {i}.png")
    return folder


def write_photographs(folder: Path, count: int = 4) -> Path:
    """Small pictures that differ."""
    folder.mkdir(parents=True)
    for i in range(count):
        Image.new("RGB", (8, 6), (i, 0, 0)).save(folder / f"{i}.jpg")
    return folder


@pytest.fixture
def fake(monkeypatch):
    """In place of pycolmap: the first three photographs are registered."""
    jobs = []

    def run(photos, job, work, progress):
        jobs.append(job)
        names = sorted(name for names in job["cameras"] for name in names)
        (Path(job["model"]) / "cameras.bin").write_text(str(job["seed"]))
        progress("features", len(names), len(names))
        return {"registered": names[:3], **NUMBERS}

    monkeypatch.setattr(registration, "_run", run)
    monkeypatch.setattr(registration, "require_pycolmap", lambda: None)
    return jobs


# What is refused


def truncated(folder: Path) -> None:
    write_photographs(folder)
    content = (folder / "2.jpg").read_bytes()
    (folder / "2.jpg").write_bytes(content[: len(content) - 100])


def videos(folder: Path) -> None:
    folder.mkdir()
    (folder / "walk.MP4").write_bytes(b"")


def telephone(folder: Path) -> None:
    folder.mkdir()
    for i in range(5):
        (folder / f"{i}.HEIC").write_bytes(b"")


def copies(folder: Path) -> None:
    write_photographs(folder, 1)
    for i in range(1, 4):
        shutil.copy(folder / "0.jpg", folder / f"{i}.jpg")


BAD = {
    "none": (lambda folder: None, "photographs: is not a folder; expected one with photographs"),
    "empty": (lambda folder: folder.mkdir(), "has 0 photographs .* need at least 3"),
    "two": (lambda folder: write_photographs(folder, 2), "has 2 photographs .* need at least 3"),
    "videos": (videos, "take at least 3 pictures out of the video"),
    "telephone": (telephone, "save those in .heic as JPEG or PNG"),
    "truncated": (truncated, r"2\.jpg: .*restore it or take it out"),
    "copies": (copies, "all 4 photographs are the same"),
}


@pytest.mark.parametrize("make, message", BAD.values(), ids=BAD)
def test_bad_folders(make, message, tmp_path, fake, capsys):
    make(tmp_path / "photographs")
    before = sorted(tmp_path.rglob("*"))
    assert cli.main(["cameras", str(tmp_path / "photographs"), "-o", str(tmp_path / "out")]) == cli.ERROR
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("jaxdr: error: ")
    with pytest.raises(ValueError, match=message):
        find_cameras(tmp_path / "photographs", tmp_path / "out")
    assert sorted(tmp_path.rglob("*")) == before and fake == []


def test_nothing_registered(tmp_path, fake, monkeypatch):
    photos = write_photographs(tmp_path / "photographs")
    monkeypatch.setattr(registration, "_run", lambda *arguments: {"registered": []})
    with pytest.raises(ValueError, match="none of the 4 photographs could be registered; take more photographs"):
        find_cameras(photos, tmp_path / "out")
    monkeypatch.setattr(registration, "_run", lambda *arguments: {"unreadable": ["1.jpg"]})
    with pytest.raises(ValueError, match=r"1\.jpg: pycolmap can't read it"):
        find_cameras(photos, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["photographs"]


def test_without_pycolmap(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(registration, "find_spec", lambda name: None)
    assert cli.main(["cameras", str(write_photographs(tmp_path / "p")), "-o", str(tmp_path / "out")]) == cli.ERROR
    assert "pip install" in capsys.readouterr().err


def test_a_process_that_fails_is_told(tmp_path, monkeypatch):
    program = tmp_path / "program.py"
    program.write_text("import sys; print('no JSON'); sys.exit('the disk is full')")
    monkeypatch.setattr(registration, "PROGRAM", program)
    with pytest.raises(OSError, match=r"p: pycolmap failed \(the disk is full\)"):
        find_cameras(write_photographs(tmp_path / "p"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


# The output folder


def test_what_is_written(tmp_path, fake, capsys):
    photos = write_photographs(tmp_path / "a/photographs")
    (photos / "masks").mkdir()
    Image.new("L", (8, 6), 255).save(photos / "masks/1.png")
    output = tmp_path / "b/c/out"
    assert cli.main(["cameras", str(photos), "-o", str(output), "--seed", "-1"]) == 0
    said = capsys.readouterr().out
    assert f"{output}: 3 of 4 photographs registered, error 0.50 pixels, 900 points" in said
    assert "without a camera: 3.jpg" in said and "newspaper" in said
    assert sorted(path.name for path in output.iterdir()) == ["images", "masks", "registration.json", "sparse"]
    assert [path.name for path in output.parent.iterdir()] == ["out"]
    for name, target in (("images", photos), ("masks", photos / "masks")):
        assert not Path((output / name).readlink()).is_absolute() and (output / name).resolve() == target
    assert fake[0]["seed"] >= 0 and fake[0]["cameras"] == (("0.jpg", "1.jpg", "2.jpg", "3.jpg"),)
    assert json.loads((output / "registration.json").read_text())["registered"] == 3


def test_copies_where_there_are_no_links(tmp_path, fake, monkeypatch):
    def refuse(*arguments, **named):
        raise OSError("no links here")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    find_cameras(write_photographs(tmp_path / "photographs/inner"), tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out/images").iterdir()) == ["0.jpg", "1.jpg", "2.jpg", "3.jpg"]


def test_overwriting(tmp_path, fake):
    photos, output = write_photographs(tmp_path / "photographs"), tmp_path / "out"
    output.mkdir()  # an empty folder is as good as none
    find_cameras(photos, output, seed=1)
    with pytest.raises(ValueError, match="out: already holds cameras; give --overwrite"):
        find_cameras(photos, output)
    find_cameras(photos, output, seed=2, overwrite=True)
    assert (output / "sparse/0/cameras.bin").read_text() == "2" and len(list(photos.iterdir())) == 4
    (output / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"out: holds notes\.txt, which was not written with the cameras"):
        find_cameras(photos, output, overwrite=True)
    (output / "registration.json").unlink()
    with pytest.raises(ValueError, match="is not empty and not a folder of cameras"):
        find_cameras(photos, output, overwrite=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="file: is a file; expected a folder"):
        find_cameras(photos, tmp_path / "file", overwrite=True)
    for place in (photos, photos / "out", tmp_path):
        with pytest.raises(ValueError, match=r"the input .*; choose another folder"):
            find_cameras(photos, place, overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "out", "photographs"]


def test_a_failure_leaves_the_earlier_cameras(tmp_path, fake, monkeypatch):
    photos, output = write_photographs(tmp_path / "photographs"), tmp_path / "out"
    find_cameras(photos, output, seed=1)

    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(registration, "_run", interrupt)
    with pytest.raises(KeyboardInterrupt):
        find_cameras(photos, output, overwrite=True)
    assert (output / "sparse/0/cameras.bin").read_text() == "1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "photographs"]


# Which files count


def test_which_files_count(tmp_path):
    photos = write_photographs(tmp_path / "photographs")
    write_photographs(photos / "more")
    for name in ("0_mask.jpg", ".hidden.jpg", "notes.txt", "film.mov", "x.HEIC"):
        shutil.copy(photos / "0.jpg", photos / name)
    Image.new("RGB", (6, 8)).save(photos / "UP.JPG")
    found = find_photographs(photos)
    assert found.cameras == (("0.jpg", "1.jpg", "2.jpg", "3.jpg"), ("UP.JPG",))
    assert found.folder == photos and found.others == {".mov": 1, ".heic": 1}


def test_photographs_in_subfolders(tmp_path):
    write_photographs(tmp_path / "p/one")
    write_photographs(tmp_path / "p/masks")
    assert find_photographs(tmp_path / "p").folder == tmp_path / "p/one"
    write_photographs(tmp_path / "p/two", 1)
    assert find_photographs(tmp_path / "p").names == ["one/0.jpg", "one/1.jpg", "one/2.jpg", "one/3.jpg", "two/0.jpg"]


def test_photographs_of_another_zoom_have_a_camera_of_their_own(tmp_path):
    photos = write_photographs(tmp_path / "p")
    for i, length in enumerate((26, 26, 52, 26)):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[41989] = length
        Image.new("RGB", (8, 6), (i, 9, 0)).save(photos / f"{i}.jpg", exif=exif)
    assert find_photographs(photos).cameras == (("0.jpg", "1.jpg", "3.jpg"), ("2.jpg",))


def test_pairs():
    names = [f"{i:04}" for i in range(400)]
    assert len(pairs(names[:100])) == 4950
    found = pairs(names)
    assert len(found) == len(set(found)) < 7000 and all(a < b for a, b in found)
    assert ("0000", "0010") in found and ("0000", "0399") in found and ("0005", "0200") in found


def test_the_report():
    found = registration.Registration(9, 9, (), 2.0, 50, (10.0, 20.0), "OPENCV", (4, 3), {".heic": 2}, 1.0)
    assert len(report(found)) == 4 and "focal length 10, 20 pixels" in report(found)[0]
    assert len(report(dataclasses.replace(found, error=0.5, others=(), unused={}))) == 1


# All of it


def bits(output: Path) -> list[bytes]:
    return [(output / f"sparse/0/{name}.bin").read_bytes() for name in ("cameras", "images", "points3D")]


def test_cameras_are_right_and_the_same_bits_again(corner, tmp_path):
    pytest.importorskip("pycolmap")
    said = []
    found = find_cameras(corner, tmp_path / "a", seed=3, progress=lambda *values: said.append(values))
    assert found.registered == found.photographs == 8 and found.error < 1.0
    assert found.focal[0] == pytest.approx(FOCAL, rel=0.03)
    assert [stage for stage, done, total in said if done == total] == ["features", "pairs", "cameras"]
    _, images = read_tables(tmp_path / "a/sparse/0")
    views = load_views(tmp_path / "a")
    assert len(views.views) == len(images) == 8
    centres = np.array([view.to_world[:3, 3] for view in sorted(views.views, key=lambda view: view.name)])
    assert distance_after_alignment(centres, np.array([centre for _, centre in poses(8)])) < 0.03
    find_cameras(corner, tmp_path / "b", seed=3)
    assert bits(tmp_path / "a") == bits(tmp_path / "b")


def distance_after_alignment(points: np.ndarray, truth: np.ndarray) -> float:
    """Root of the mean squared distance after the best similarity (Umeyama 1991)."""
    a, b = points - points.mean(0), truth - truth.mean(0)
    u, s, v = np.linalg.svd(b.T @ a)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ v))])
    scale = (s * sign).sum() / (a**2).sum()
    return float(np.sqrt(((scale * a @ (u * sign @ v).T - b) ** 2).sum(1).mean()))


def test_control_c_leaves_nothing(corner, tmp_path):
    pytest.importorskip("pycolmap")
    command = [sys.executable, "-m", "jaxdr", "cameras", str(corner), "-o", str(tmp_path / "out")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        for line in process.stderr:
            if "features" in line:
                process.send_signal(signal.SIGINT)
                break
        start = time.monotonic()
        said = process.stderr.read()
        assert process.wait(20) == cli.INTERRUPTED and "jaxdr: interrupted" in said and "Traceback" not in said
    assert time.monotonic() - start < 20 and list(tmp_path.iterdir()) == []
