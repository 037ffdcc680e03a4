"""Whole reconstructions, tiny: what is written, resuming, interruption, errors. Two programs are compiled."""

import csv
import json
import re
import shutil

import jax
import numpy as np
import pytest
import trimesh
from PIL import Image

import jaxdr as jd
from jaxdr.cli import main
from jaxdr.optimize.progress import Interrupted, Stopped
from jaxdr.optimize.reconstruction import reconstruct
from jaxdr.optimize.reconstruction.asset_frame import AssetFrame
from jaxdr.optimize.reconstruction.config import LEVELS, QUALITIES, ReconstructConfig, reconstruct_config
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.optimize.reconstruction.results import save_cameras
from jaxdr.views import pictures
from tests.views.folders import SIZE, tell_apart, write_colmap, write_nerf

for package in ("gpytoolbox", "skimage", "xatlas"):
    pytest.importorskip(package)

TABLE = {
    "start": {"grid": 24},
    "samples": {"image": 1, "gradient": 1, "pictures": 4},
    "integrator": {"boundary": "none"},  # quick to compile; examples/ has it
    "levels": [
        {"steps": 2, "resolution": SIZE, "vertices": 60, "views": 1, "sky": 3},
        {"steps": 2, "resolution": SIZE, "vertices": 60, "views": 2, "sky": 3, "texture": 32},
    ],
    "report": {"checkpoint": 3, "pictures": 3, "texture": 32, "turntable": 2},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tell_apart(write_nerf(tmp_path_factory.mktemp("photos") / "nerf", train=6, test=2))


def config(folder, output, **changes) -> ReconstructConfig:
    return reconstruct_config(TABLE | changes, "test", str(folder), str(output))


@pytest.fixture(scope="module")
def finished(folder, tmp_path_factory):
    output = tmp_path_factory.mktemp("out") / "whole"
    return output, reconstruct.reconstruct(config(folder, output))


def test_everything_is_there(folder, finished):
    output, summary = finished
    views = jd.load_views(folder)
    assert summary == json.loads((output / "metrics.json").read_text())
    assert summary["steps"] == 4 and summary["start"] == "hull" and summary["judged_by"] == "held out"
    assert {view["name"] for view in summary["views"]} == {"r_0", "r_1"} and summary["iou"]["mean"] > 0.5
    assert sorted(path.name for path in (output / "test").iterdir()) == ["r_0.png", "r_1.png"]
    pixels = np.asarray(Image.open(output / "test" / "r_0.png"))
    assert pixels.shape == (SIZE, SIZE, 4)
    mesh = trimesh.load_scene(output / "asset.glb", process=False).to_geometry()
    low, high = mesh.bounds
    assert abs(low[1]) < 1e-5 and (np.abs(low + high)[[0, 2]] < 1e-5).all() and 0.4 < (high - low).max() < 2
    back = np.linalg.inv(np.array(summary["to_asset"]))
    middle = back[:3, :3] @ (low + high) / 2 + back[:3, 3]
    assert (np.abs(middle) < 0.3).all()  # where the cameras look
    assert list(jd.load_gltf(output / "asset.glb").shapes) == ["object"]
    light = next(output.glob("light.*"))
    assert jd.load_image(light).shape == (9, 16, 3) and (jd.load_image(light) > 0).all()
    assert sorted(path.name for path in (output / "compared").iterdir()) == ["r_0.png", "r_1.png"]
    page = (output / "report.html").read_text()
    assert "data:model/gltf-binary" in page and "data:image/gif" in page and 'src="http' not in page
    assert re.search(r"<figcaption>r_0 · [\d.]+ dB · .* dB inside · SSIM .* · overlap [\d.]+</figcaption>", page)
    assert Image.open(output / "turntable.gif").n_frames == 2
    rows = list(csv.DictReader((output / "metrics.csv").open()))
    assert [row["level"] for row in rows] == ["1", "1", "2", "2"]
    assert all(0 < float(row["loss"]) < 1 for row in rows)
    again = jd.load_views(output)  # transforms.json is in a layout of ours
    np.testing.assert_allclose(back @ again.views[3].to_world, views.views[3].to_world, rtol=0, atol=1e-9)
    assert again.views[3].focal == pytest.approx(views.views[3].focal)


def test_resumed_after_ctrl_c_it_ends_with_the_same_bits(folder, finished, tmp_path, monkeypatch):
    whole, summary = finished
    output = tmp_path / "parts"
    step = reconstruct.ReconstructionTask.step

    def press(self, current, done, say):
        self.interruption.requested = done == 2  # in the first step of the second level
        return step(self, current, done, say)

    monkeypatch.setattr(reconstruct.ReconstructionTask, "step", press)
    with pytest.raises(Interrupted, match="stopped after step 3"):
        reconstruct.reconstruct(config(folder, output))
    assert (output / "asset.glb").exists() and list(output.glob("light.*")) and not (output / "metrics.json").exists()
    assert len(jd.load_views(output).views) == 8  # cameras in the frame of the asset
    page = (output / "report.html").read_text()
    assert "The run is not finished" in page and "data:model/gltf-binary" in page
    monkeypatch.setattr(reconstruct.ReconstructionTask, "step", step)
    resumed = reconstruct.reconstruct(config(folder, output), resume=True)
    timeless = lambda d: {k: v for k, v in d.items() if not k.startswith("seconds")}  # noqa: E731
    assert timeless(resumed) == timeless(summary)
    one, other = np.load(whole / "checkpoint.npz"), np.load(output / "checkpoint.npz")
    assert one.files == other.files
    for name in set(one.files) - {"seconds"}:
        assert (one[name] == other[name]).all(), name
    for name in ("asset.glb", "test/r_0.png"):
        assert (whole / name).read_bytes() == (output / name).read_bytes()
    lines = [(path / "metrics.csv").read_text().splitlines() for path in (whole, output)]
    assert [line.rpartition(",")[0] for line in lines[0]] == [line.rpartition(",")[0] for line in lines[1]]


def test_points_hold_the_surface_and_a_resumed_run_ends_with_the_same_bits(folder, tmp_path, monkeypatch):
    """Points at half the depth of the hull: the coarsest level is left out, and the surface is near them."""

    def points(views, pose, radius):
        away = np.stack([view.to_world[:3, 3] - pose.centre for view in views])
        turned = (
            np.random.default_rng(0).normal(0, 0.3, (60, len(views), 3)) + away / np.linalg.norm(away, axis=-1)[:, None]
        )
        inner = pose.centre + 0.25 * pose.scale * turned / np.linalg.norm(turned, axis=-1, keepdims=True)
        return np.broadcast_to(away + pose.centre, turned.shape).reshape(-1, 3), inner.reshape(-1, 3)

    monkeypatch.setattr(reconstruct, "stereo_points", points)
    step = reconstruct.ReconstructionTask.step
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    summary = reconstruct.reconstruct(config(folder, whole))
    assert summary["steps"] == 2  # of four

    def press(self, current, done, say):
        assert current.stage.mesh.vertices.shape[0] < 200 and self.photos.seen is not None
        self.interruption.requested = done == 0
        return step(self, current, done, say)

    monkeypatch.setattr(reconstruct.ReconstructionTask, "step", press)
    with pytest.raises(Interrupted, match="stopped after step 1"):
        reconstruct.reconstruct(config(folder, parts))
    monkeypatch.setattr(reconstruct.ReconstructionTask, "step", step)
    reconstruct.reconstruct(config(folder, parts), resume=True)
    for name in ("asset.glb", "test/r_0.png", "transforms.json"):
        assert (whole / name).read_bytes() == (parts / name).read_bytes(), name


def test_with_no_picture_kept_it_ends_with_the_same_bits(folder, finished, tmp_path, monkeypatch):
    whole, _ = finished
    output, read = tmp_path / "streamed", []
    original = pictures.load_stored
    monkeypatch.setattr(pictures, "load_stored", lambda *files: (read.append(files), original(*files))[1])
    reconstruct.reconstruct(config(folder, output, memory={"pictures": 0.0}))
    assert len(read) > 5 * 8  # of eight pictures
    for name in ("asset.glb", "test/r_0.png", "test/r_1.png", "compared/r_0.png", "pictures/00004.png"):
        assert (whole / name).read_bytes().replace(b"whole", b"") == (output / name).read_bytes(), name


def test_a_photograph_that_vanishes_is_told_with_the_checkpoint(folder, tmp_path, monkeypatch):
    photos = tmp_path / "photos"
    shutil.copytree(folder, photos)
    step = reconstruct.ReconstructionTask.step

    def unplug(self, current, done, say):
        result = step(self, current, done, say)
        shutil.rmtree(photos / "train", ignore_errors=True)
        return result

    monkeypatch.setattr(reconstruct.ReconstructionTask, "step", unplug)
    with pytest.raises(Stopped, match=r"r_\d\.png: there is no such file; the checkpoint of step 0 in .* is whole"):
        reconstruct.reconstruct(config(photos, tmp_path / "out", memory={"pictures": 0.0}))


def test_a_held_out_picture_that_cannot_be_read_is_told_before_the_start(tmp_path):
    photos = write_nerf(tmp_path / "nerf", train=3, test=2)
    path = photos / "test" / "r_1.png"
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(ValueError, match=r"test/r_1\.png: not a readable PNG"):
        reconstruct.reconstruct(config(photos, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_results_are_not_overwritten_unasked(folder, finished):
    output, _ = finished
    before = (output / "asset.glb").stat().st_mtime_ns
    with pytest.raises(ValueError, match="already holds results"):
        reconstruct.reconstruct(config(folder, output))
    with pytest.raises(ValueError, match="finished; there is nothing to resume"):
        reconstruct.reconstruct(config(folder, output), resume=True)
    with pytest.raises(ValueError, match="seed was 0, is 1"):
        reconstruct.reconstruct(config(folder, output, seed=1), resume=True)
    assert (output / "asset.glb").stat().st_mtime_ns == before


def test_without_masks_it_starts_from_a_sphere(tmp_path):
    run = reconstruct.ReconstructionTask(
        config(write_nerf(tmp_path, alpha=False), tmp_path / "out"), jd.load_views(tmp_path), jax.devices()[:1]
    )
    assert run.kind == "sphere"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--set", "rates.vertics=1"], ["--set: rates.vertics", "did you mean 'vertices'"]),
        (["--set", "levels=[{steps=0,resolution=16,vertices=60}]"], ["levels[0].steps", "at least 1"]),
        (["--set", "priors.mask=-1"], ["priors.mask", "negative"]),
        (["--set", 'unknown=["normals"]'], ["unknown[0]", "albedo"]),
        (["--config", "nowhere.toml"], ["nowhere.toml", "can't be read"]),
        (["--holdout", "x_*"], ["matches the holdout pattern 'x_*'"]),
    ],
)
def test_mistakes_end_with_one_line_and_nothing_written(folder, tmp_path, capsys, arguments, words):
    output = tmp_path / "out"
    assert main(["reconstruct", str(folder), "-o", str(output), "--no-cache", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("jaxdr: error: ")
    assert all(word in lines[0] for word in words), lines[0]
    assert not output.exists()


def test_a_file_of_settings_and_overrides(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text("seed = 3\n[priors]\nalbedo = 0.5\n")
    from jaxdr.optimize.strict_toml import read_toml

    made = reconstruct_config(read_toml(path, ["priors.light=0.1"]), str(path), "photos", "out", "*_3")
    assert (made.seed, made.priors.albedo, made.priors.light, made.holdout) == (3, 0.5, 0.1, "*_3")
    assert made.levels == LEVELS and made.steps == sum(level.steps for level in LEVELS)


def test_quality_chooses_the_levels():
    for name, levels in QUALITIES.items():
        assert reconstruct_config({"seed": 3}, "--set", "photos", "out", quality=name).levels == levels
    with pytest.raises(ValueError, match="must be one of draft, normal, high"):
        reconstruct_config({}, "--set", "photos", "out", quality="best")
    with pytest.raises(ValueError, match=r"settings\.toml: levels: --quality chooses them"):
        reconstruct_config({"levels": []}, "settings.toml", "photos", "out", quality="draft")


def test_bidirectional_paths_are_refused():
    with pytest.raises(ValueError, match=r"integrator\.kind: must be \"path\" here"):
        reconstruct_config({"integrator": {"kind": "bdpt"}}, "settings.toml", "photos", "out")


def test_cameras_are_corrected_and_written(tmp_path):
    """Those of fitted photographs; others stay as they are."""
    photos, output = write_nerf(tmp_path / "nerf", train=4, test=2), tmp_path / "out"
    given = jd.load_views(photos)
    level = {"steps": 2, "resolution": SIZE, "vertices": 60, "views": 2, "sky": 3}
    changes = {"unknown": ["light", "cameras"], "levels": [level], "rates": {"cameras": 0.01}}
    summary = reconstruct.reconstruct(config(photos, output, **changes))
    assert 0 < summary["cameras"]["largest_turn_degrees"] < 5 and 0 < summary["cameras"]["largest_shift"] < 0.1
    found, back = jd.load_views(output), np.linalg.inv(np.array(summary["to_asset"]))
    for before, after in zip(given.views, found.views, strict=True):
        assert (np.abs(before.to_world - back @ after.to_world).max() > 1e-4) != before.held_out


@pytest.mark.parametrize("name", ["train/r_3.png", "test/r_1.png", "transforms_train.json"])
def test_photographs_that_were_replaced_are_told(folder, tmp_path, name):
    """With files of the same size, which only their contents tell apart."""
    photos, output = tmp_path / "photos", tmp_path / "out"
    shutil.copytree(folder, photos)
    views = jd.load_views(photos)
    with OutputFolder(config(photos, output), views).opened(False, False):
        pass
    data = bytearray((photos / name).read_bytes())
    data[-1] ^= 1
    (photos / name).write_bytes(data)
    with pytest.raises(ValueError, match=rf"{name}: has other contents than when the run began"):
        with OutputFolder(config(photos, output), views).opened(True, False):
            pass


def test_the_output_is_apart_from_the_photographs(folder, tmp_path):
    photos = tmp_path / "photos"
    shutil.copytree(folder, photos)
    for output in (photos, photos / "out", tmp_path):
        for overwrite in (False, True):
            with pytest.raises(ValueError, match=r"(is|lies in|holds) the input .*photos; choose another folder"):
                reconstruct.reconstruct(config(photos, output), overwrite=overwrite)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["photos"]


def test_masks_are_named_for_those_who_read_the_result_again(tmp_path):
    views = jd.load_views(write_colmap(tmp_path / "photos"))
    assert views.masked and views.views[0].mask is not None
    folder = OutputFolder(config(tmp_path / "photos", tmp_path / "out"), views)
    folder.path.mkdir()
    save_cameras(folder, views, AssetFrame(np.eye(3), 1.0, np.zeros(3)))
    again = jd.load_views(tmp_path / "out")
    for one, other in zip(views.views, again.views, strict=True):
        assert other.mask == one.mask and (other.alpha == one.alpha).all()
