"""Damaged and hostile tables of cameras: one error with the file and the place, and no number that the file lacks."""

import json
import math
import os
import struct

import numpy as np
import pytest

import jaxdr as jd
from tests.views.folders import FOCAL, SIZE, edit_json, poses, quaternion, write_colmap, write_nerf

TRAIN, MODEL = "transforms_train.json", "sparse/0"


def camera(number=1, model=1, width=SIZE, height=SIZE, parameters=(FOCAL, FOCAL, 8.0, 8.0)) -> bytes:
    return struct.pack(f"<IiQQ{len(parameters)}d", number, model, width, height, *parameters)


def image(number=1, pose=None, of=1, name=b"train_0.png\0", points=1, stored=1) -> bytes:
    if pose is None:
        world = np.linalg.inv(poses(3)[0] @ np.diag([-1.0, -1, 1, 1]))
        pose = (*quaternion(world[:3, :3]), *world[:3, 3])
    head = struct.pack("<I7dI", number, *pose, of) + name + struct.pack("<Q", points)
    return head + struct.pack("<ddq", 3.0, 4.0, -1) * stored


def table(*rows: bytes, count: int | None = None) -> bytes:
    return struct.pack("<Q", len(rows) if count is None else count) + b"".join(rows)


def binary(folder, cameras=None, images=None):
    """A binary model of one image; tables that photographs don't need are empty or damaged."""
    write_colmap(folder, masks=False)
    for path in (folder / MODEL).iterdir():
        path.unlink()
    files = {"cameras": table(camera()), "images": table(image()), "points3D": b"", "frames": b"\xff" * 9}
    files |= {name: data for name, data in (("cameras", cameras), ("images", images)) if data is not None}
    for name, data in files.items():
        (folder / MODEL / f"{name}.bin").write_bytes(data)
    return folder


def test_a_binary_model_needs_cameras_and_images_only(tmp_path):
    unused = camera(2, model=4, parameters=(1.0,) * 8)
    (view,) = jd.load_views(binary(tmp_path, table(unused, camera()))).views
    np.testing.assert_allclose(view.to_world, poses(3)[0], atol=1e-12)
    assert (view.name, view.focal, view.centre) == ("train_0", pytest.approx(FOCAL), (8, 8))


@pytest.mark.parametrize("suffix", ["bin", "txt"])
def test_it_is_what_colmap_reads(tmp_path, suffix):
    """A model with two cameras in a rig, whose poses COLMAP computes from those of the rig."""
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=2, num_frames_per_rig=3, num_points3D=20, camera_model_id=1
    )
    found = pycolmap.synthesize_dataset(options)
    (tmp_path / MODEL).mkdir(parents=True)
    (found.write_binary if suffix == "bin" else found.write_text)(str(tmp_path / MODEL))
    from jaxdr.views.layouts.colmap import _world_to_camera
    from jaxdr.views.layouts.colmap_tables import read_tables

    cameras, images = read_tables(tmp_path / MODEL)
    assert sorted(images) == sorted(found.images) and len(images) == 6
    for number, row in images.items():
        expected = found.images[number]
        assert row.name == expected.name and row.camera == expected.camera_id
        np.testing.assert_allclose(_world_to_camera(row)[:3], expected.cam_from_world().matrix(), atol=1e-9)
    for number, row in cameras.items():
        expected = found.cameras[number]
        assert (row.model, row.width, row.height) == (expected.model.name, expected.width, expected.height)
        np.testing.assert_allclose(row.parameters, expected.params)


def test_lens_models_are_those_of_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    from jaxdr.views.layouts.colmap_tables import PARAMETERS

    for number, (name, count) in enumerate(PARAMETERS.items()):
        known = getattr(pycolmap.CameraModelId, name, None)
        if known is not None:  # an older COLMAP has fewer
            assert int(known) == number
            assert len(pycolmap.Camera.create_from_model_id(1, known, 9.0, 9, 9).params) == count


POSE = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"cameras": b""}, "cameras.bin: the number of cameras: takes 8 bytes, the file has 0 more"),
        ({"cameras": table(camera()[:-22])}, "cameras.bin: says 1 cameras, which take 40 bytes or more; it has 34"),
        ({"cameras": table(camera()[:-8])}, "cameras.bin: camera row 0: takes 32 bytes, the file has 24 more"),
        ({"cameras": table(camera()) + b"\0"}, "cameras.bin: has 1 bytes behind its last camera"),
        ({"cameras": table(camera(), count=2**63)}, "cameras.bin: says 9223372036854775808 cameras"),
        ({"cameras": table(camera(model=99))}, "cameras.bin: camera row 0: camera model 99 is unknown"),
        ({"cameras": table(camera(model=-1))}, "camera model -1 is unknown"),
        ({"cameras": table(camera(), camera())}, "cameras.bin: camera 1 is there twice"),
        ({"cameras": table(camera(width=2**60))}, "cameras.bin: camera 1: expected 1 to 134217728 pixels"),
        ({"cameras": table(camera(parameters=(FOCAL, FOCAL, math.nan, 8.0)))}, "cameras.bin: camera 1: a parameter"),
        ({"cameras": table(camera(parameters=(1e12, 1e12, 8.0, 8.0)))}, "the focal length must be from"),
        ({"cameras": table(camera(parameters=(FOCAL, FOCAL, 1e12, 8.0)))}, "the principal point: must be"),
        ({"images": b"\1\0"}, "images.bin: the number of images: takes 8 bytes, the file has 2 more"),
        ({"images": table()}, "has no image with a pose"),
        ({"images": table(image(), count=10**9)}, "images.bin: says 1000000000 images"),
        ({"images": table(image(points=2**60))}, "images.bin: image row 0: its 1152921504606846976 points: takes"),
        ({"images": table(image(points=1, stored=0))}, "images.bin: image row 0: its 1 points: takes 24 bytes"),
        ({"images": table(image(stored=2))}, "images.bin: has 24 bytes behind its last image"),
        ({"images": table(image(name=b"train_0.png"))}, "images.bin: "),
        ({"images": table(image(name=b"x" * 90, stored=0)[:-8])}, "image row 0: the file ends inside of a name"),
        ({"images": table(image(name=b"\xff\0"))}, "images.bin: image row 0: a name that is not UTF-8"),
        ({"images": table(image(name=b"\0"))}, "names a picture ''; expected the path of a file"),
        ({"images": table(image(name=b"a\nb\0"))}, r"names a picture 'a\nb'; expected the path of a file"),
        ({"images": table(image(of=3))}, "images.bin: image 1 has camera 3, which is missing"),
        ({"images": table(image(), image(2))}, "images.bin: two images are called 'train_0.png'"),
        ({"images": table(image(pose=(*POSE[:4], math.inf, 0.0, 0.0)))}, "images.bin: image 1: the pose: must be"),
        ({"images": table(image(pose=(0.0,) * 7))}, "images.bin: image 1: the quaternion must have length 1"),
        ({"images": table(image(pose=(2.0, *POSE[1:])))}, "the quaternion must have length 1, it has 2"),
    ],
)
def test_binary_tables(tmp_path, tables, message):
    with pytest.raises(ValueError) as caught:
        jd.load_views(binary(tmp_path, **tables))
    assert str(tmp_path) in str(caught.value) and message in str(caught.value) and "\n" not in str(caught.value)


def test_one_table_of_two(tmp_path):
    (binary(tmp_path) / MODEL / "images.bin").unlink()
    with pytest.raises(ValueError, match="has no table of images beside that of cameras"):
        jd.load_views(tmp_path)


CAMERA, ROW = f"1 PINHOLE {SIZE} {SIZE} {FOCAL} {FOCAL} 8 8\n", "1 1 0 0 0 0 0 2 1 train_0.png\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cameras", f"1 PINHOLE {SIZE} {SIZE} {FOCAL} {FOCAL} 8\n", "line 1: a PINHOLE camera has 4 parameters, got 3"),
        ("cameras", "# a comment\n1 PINHOLE\n", "line 2: a camera needs an id, a model, width, height and parameters"),
        ("cameras", CAMERA.replace(" 8 8", " nan 8"), "line 1: a parameter: must be a finite number"),
        ("cameras", CAMERA.replace(" 8 8", " 8_0 8"), "line 1: expected a number, got '8_0'"),
        (
            "cameras",
            CAMERA.replace(" 16 16", " -16 16"),
            "must be a whole number from 0 to 4294967295, got -16",
        ),
        ("cameras", CAMERA.replace(" 16 16", f" {'9' * 5000} 16"), "line 1: expected a whole number, got '999"),
        ("cameras", CAMERA * 2, "camera 1 is there twice"),
        ("cameras", "# Number of cameras: 2\n" + CAMERA, "has 1 of the 2 cameras that its comment says"),
        ("cameras", b"\xff", "can't be read as text in UTF-8"),
        ("images", ROW.replace("train_0.png", ""), "line 1: an image needs an id, a quaternion, a translation"),
        ("images", ROW.replace("1 1 0", "1 nan 0"), "line 1: the pose: must be a finite number"),
        ("images", ROW + ROW.replace("1 1 0", "2 1 0"), "line 2: expected the points of 'train_0.png'"),
        ("images", ROW + "3 4\n", "line 2: expected the points of 'train_0.png', three numbers each"),
        ("images", ROW + "\n" + ROW.replace("1 1 0", "2 1 0"), "two images are called 'train_0.png'"),
        ("images", "# Number of images: 3, mean\n" + ROW + "\n", "has 1 of the 3 images that its comment says"),
    ],
)
def test_text_tables(tmp_path, name, text, message):
    write_colmap(tmp_path, masks=False)
    path = tmp_path / MODEL / f"{name}.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError) as caught:
        jd.load_views(tmp_path)
    assert str(caught.value).startswith(f"{path}: ") and message in str(caught.value)


def test_a_picture_is_never_its_own_mask(tmp_path):
    """Pictures outside of the folder of pictures have the masks of their last names."""
    write_colmap(tmp_path)
    pictures = tmp_path / "images"
    for path in list(pictures.iterdir()):
        path.rename(tmp_path / path.name)
    images = tmp_path / MODEL / "images.txt"
    text = images.read_text()
    for prefix in ("../", f"{tmp_path}/"):
        images.write_text(text.replace(" train", f" {prefix}train").replace(" test", f" {prefix}test"))
        assert {view.mask for view in jd.load_views(tmp_path).views} == set((tmp_path / "masks").iterdir())


def change_all(**values):
    return lambda document: document.update(values)


def change_one(**values):
    return lambda document: document["frames"][1].update(values)


def set_pose(row, column, value):
    def change(document):
        document["frames"][1]["transform_matrix"][row][column] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (change_all(fl_x=10**100), "frames[0]: fl_x: must be a finite number from"),
        (change_all(fl_x=1e300), "frames[0]: fl_x: must be a finite number from"),
        (change_all(fl_x=1e12), "frames[0]: the focal length must be from"),
        (change_all(fl_x=1e-12), "frames[0]: the focal length must be from"),
        (change_all(fl_x=-20), "frames[0]: the focal length must be from"),
        (change_all(fl_x="20"), "frames[0]: fl_x: expected a number, got '20'"),
        (change_all(fl_x=20, fl_y=None), "frames[0]: fl_y: expected a number, got None"),
        (change_all(camera_angle_x=math.pi), "the focal length must be from"),
        (change_all(camera_angle_x=1e-9), "the focal length must be from"),
        (change_all(cx=1e17), "frames[0]: the principal point: must be"),
        (change_all(w=-16), "frames[0]: w: must be a finite number from 1"),
        (change_all(w=10**9), "frames[0]: w: must be a finite number from 1"),
        (change_all(w=16.5), "frames[0]: w must be a whole number of pixels, got 16.5"),
        (change_all(h=True), "frames[0]: h: expected a number, got True"),
        (change_all(k1="0"), "frames[0]: k1: expected a number, got '0'"),
        (change_all(camera_model=["PINHOLE"] * 99), "frames[0]: a lens ['PINHOLE'"),
        (change_all(frames={}), "has no frames"),
        (change_all(frames=[[]]), "frames[0]: has no file_path"),
        (change_one(file_path=""), "names a picture ''; expected the path of a file"),
        (change_one(file_path=".."), "names a picture '..'; expected the path of a file"),
        (change_one(file_path="a\0b"), "names a picture 'a\\x00b'; expected the path of a file"),
        (change_one(file_path="a\nb"), "names a picture 'a\\nb'; expected the path of a file"),
        (change_one(file_path="\ud800"), "names a picture '\\ud800'; expected the path of a file"),
        (change_one(file_path="x" * 100_000), "; expected the path of a file"),
        (change_one(mask_path=5), "frames[1]: mask_path must be the name of a file, got 5"),
        (change_one(held_out=1), "frames[1]: held_out must be true or false, got 1"),
        (change_one(transform_matrix=5), "frames[1]: transform_matrix must be 4 x 4 finite numbers"),
        (change_one(transform_matrix=[[1, 2]]), "frames[1]: transform_matrix must be 4 x 4 finite numbers"),
        (set_pose(0, 3, 10**300), "frames[1]: transform_matrix: must be a finite number from"),
        (set_pose(0, 3, "1"), "frames[1]: transform_matrix: expected a number, got '1'"),
        (set_pose(3, 3, 5), "frames[1]: the pose must be a rotation and a translation"),
    ],
)
def test_transforms(tmp_path, change, message):
    write_nerf(tmp_path)
    edit_json(tmp_path / TRAIN, change)
    with pytest.raises(ValueError) as caught:
        jd.load_views(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / TRAIN}: ") and message in str(caught.value)
    assert len(str(caught.value)) < 1000 and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ['{"frames": ' + "[" * 100_000, '{"w": NaN}', '{"w": 1e999}', '{"w": ' + "9" * 9999 + "}", "\0", b"\xff"]
)
def test_json_that_is_none(tmp_path, text):
    write_nerf(tmp_path)
    (tmp_path / TRAIN).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=f"{TRAIN}: is not readable JSON"):
        jd.load_views(tmp_path)


def test_pictures_may_be_elsewhere_and_links_but_no_pipes(tmp_path):
    folder = write_nerf(tmp_path / "scene")
    (folder / "train/r_1.png").rename(tmp_path / "other.png")
    (folder / "train/r_1.png").symlink_to(tmp_path / "other.png")
    (folder / "train/r_2.png").rename(tmp_path / "r_2.png")
    edit_json(folder / TRAIN, lambda document: document["frames"][2].update(file_path="../r_2.png"))
    assert [view.image.shape for view in jd.load_views(folder).fitted] == [(SIZE, SIZE, 3)] * 4
    (folder / "train/r_1.png").unlink()
    os.mkfifo(folder / "train/r_1.png")
    with pytest.warns(UserWarning, match="1 of 4 pictures are missing and left out: ./train/r_1"):
        jd.load_views(folder)


@pytest.mark.parametrize("name", ["train", "/dev/null", "/dev/zero.png", "train/r_9"])
def test_what_is_no_picture_is_missing(tmp_path, name):
    write_nerf(tmp_path)
    edit_json(tmp_path / TRAIN, change_one(file_path=name))
    with pytest.warns(UserWarning, match=f"1 of 4 pictures are missing and left out: {name}"):
        assert len(jd.load_views(tmp_path).fitted) == 3


def test_sizes_with_a_fraction_of_zero(tmp_path):
    write_nerf(tmp_path)
    edit_json(tmp_path / TRAIN, change_all(w=float(SIZE), h=SIZE, k1=0, camera_model="OPENCV"))
    assert json.loads((tmp_path / TRAIN).read_text())["w"] == SIZE
    assert len(jd.load_views(tmp_path).views) == 6
