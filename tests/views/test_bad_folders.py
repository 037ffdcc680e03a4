"""Bad folders of photographs: one error each, which names the place, the fault and the remedy."""

import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from tests.views.folders import SIZE, disc, edit_json, write_colmap, write_json, write_nerf


def _frames(folder, change):
    edit_json(folder / "transforms_train.json", lambda document: change(document["frames"]))


def nothing(folder):
    folder.joinpath("notes.txt").write_text("no cameras")


def broken_json(folder):
    write_nerf(folder)
    (folder / "transforms_train.json").write_text('{"frames": [')


def no_frames(folder):
    write_json(folder / "transforms.json", {"camera_angle_x": 0.6, "frames": []})


def no_picture_left(folder):
    write_nerf(folder, test=0)
    for path in (folder / "train").iterdir():
        path.unlink()


def damaged_picture(folder):
    write_nerf(folder)
    (folder / "train" / "r_1.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"0" * 40)


def cut_off(folder):
    write_nerf(folder)
    path = folder / "train" / "r_3.png"
    path.write_bytes(path.read_bytes()[:60])  # the header is whole


def not_finite(folder):
    write_nerf(folder, test=0)
    for i in range(4):
        np.save(folder / "train" / f"{i}.npy", np.full((SIZE, SIZE, 3), np.nan if i == 2 else 0.5, np.float32))
    _frames(folder, lambda frames: [frame.update(file_path=f"train/{i}.npy") for i, frame in enumerate(frames)])


def size_is_not_the_cameras(folder):
    write_nerf(folder)
    edit_json(folder / "transforms_train.json", lambda document: document.update(w=SIZE, h=2 * SIZE))


def distortion_without_focal_length(folder):
    write_nerf(folder)
    edit_json(folder / "transforms_train.json", lambda document: document.update(k1=-0.1, p2=0.01))


def distortion_without_size(folder):
    write_nerf(folder)
    edit_json(folder / "transforms_train.json", lambda document: document.update(fl_x=20.0, k1=-0.1, cx=8.0, cy=8.0))


def wrong_parameters(folder):
    write_nerf(folder)
    values = {"camera_model": "FOV", "camera_params": [20.0, 20.0, 8.0], "w": SIZE, "h": SIZE}
    edit_json(folder / "transforms_train.json", lambda document: document.update(values))


def panorama(folder):
    write_colmap(folder)
    (folder / "sparse/0/cameras.txt").write_text("1 EQUIRECTANGULAR 16 16 8 8\n")


def no_focal_length(folder):
    write_nerf(folder)
    edit_json(folder / "transforms_train.json", lambda document: document.pop("camera_angle_x"))


def held_out_by_a_word(folder):
    write_nerf(folder)
    _frames(folder, lambda frames: frames[1].update(held_out="yes"))


def skewed_pose(folder):
    write_nerf(folder)
    _frames(folder, lambda frames: frames[1]["transform_matrix"][0].__setitem__(0, 2.0))


def looking_away(folder):
    write_nerf(folder)

    def turn(frames):
        for frame in frames:
            frame["transform_matrix"] = (np.asarray(frame["transform_matrix"]) @ np.diag([-1.0, 1, -1, 1])).tolist()

    _frames(folder, turn)


def empty_mask(folder):
    write_nerf(folder)
    Image.fromarray(np.zeros((SIZE, SIZE, 4), np.uint8)).save(folder / "train" / "r_0.png")


def mask_of_another_shape(folder):
    write_colmap(folder)
    Image.fromarray((255 * disc()[:12]).astype(np.uint8)).save(folder / "masks" / "train_1.png")


def damaged_colmap(folder):
    write_colmap(folder)
    (folder / "sparse/0/cameras.txt").write_text("1 PINHOLE 16 many\n")


IN_PIXELS = (empty_mask, cut_off, not_finite)  # headers do not tell


@pytest.mark.parametrize(
    "make, place, fault",
    [
        (nothing, "{folder}", "has no cameras that are known"),
        (broken_json, "transforms_train.json", "not readable JSON"),
        (no_frames, "transforms.json", "has no frames"),
        (no_picture_left, "r_0", "missing"),
        (damaged_picture, "r_1.png", "not a readable PNG"),
        (cut_off, "r_3.png", "not a readable PNG"),
        (not_finite, "2.npy", "pixels that are not finite"),
        (size_is_not_the_cameras, "transforms_train.json: frames[0]", "says height 32, r_0.png has 16 pixels"),
        (distortion_without_focal_length, "frames[0]", "has distortion but no fl_x"),
        (distortion_without_size, "frames[0]", "has distortion but not all of cx, cy, w, h"),
        (wrong_parameters, "frames[0]", "camera_params of a FOV lens must be 5 numbers"),
        (panorama, "test_2.png", "is a panorama"),
        (no_focal_length, "frames[0]", "neither fl_x nor camera_angle_x"),
        (held_out_by_a_word, "frames[1]", "held_out must be true or false, got 'yes'"),
        (skewed_pose, "frames[1]", "a rotation and a translation"),
        (looking_away, "{folder}", "4 of 6 cameras look away"),
        (empty_mask, "r_0.png", "the mask is empty"),
        (mask_of_another_shape, "train_1.png", "the mask has 16 x 12 pixels"),
        (damaged_colmap, "sparse/0/cameras.txt: line 1", "expected a whole number, got 'many'"),
    ],
    ids=lambda value: value.__name__ if callable(value) else "",
)
def test_one_clear_error(tmp_path, make, place, fault):
    make(tmp_path)
    with pytest.raises(ValueError) as caught:
        views = jd.load_views(tmp_path)
        assert make in IN_PIXELS, "said too late"
        for view in views.views:
            view.image  # noqa: B018
    message = str(caught.value)
    assert place.format(folder=tmp_path) in message and fault in message
    assert "\n" not in message


def test_a_folder_that_is_none(tmp_path):
    with pytest.raises(ValueError, match="is not a folder"):
        jd.load_views(tmp_path / "nowhere")


def test_holdout_that_matches_nothing_or_everything(tmp_path):
    write_nerf(tmp_path)
    with pytest.raises(ValueError, match=r"matches the holdout pattern 'x\*'"):
        jd.load_views(tmp_path, holdout="x*")
    with pytest.raises(ValueError, match="none is left to fit"):
        jd.load_views(tmp_path, holdout="*")
