"""Photographs as they come: distorted, of oblong pixels, of several sizes, turned, with masks of any kind."""

import warnings

import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.image_formats import png
from jaxdr.images import to_srgb
from jaxdr.views.area import area_mean
from jaxdr.views.layouts.transforms import FROM_OPENGL, lens_entries
from jaxdr.views.lens import ONE_FOCAL, Lens
from jaxdr.views.resample import TURNS, UNDONE, resampled, turned, turned_size
from tests.views.folders import SIZE, disc, edit_json, poses, write_colmap, write_json, write_nerf, write_picture

BENT = {
    "OPENCV": (150.0, 155.0, 101.0, 78.0, -0.2, 0.05, 0.003, -0.002),
    "FULL_OPENCV": (150.0, 155.0, 101.0, 78.0, -0.2, 0.05, 0.003, -0.002, 0.01, 0.0, 0.0, 0.0),
    "SIMPLE_RADIAL": (150.0, 101.0, 78.0, -0.15),
    "RADIAL": (150.0, 101.0, 78.0, 0.1, 0.02),
    "OPENCV_FISHEYE": (110.0, 111.0, 101.0, 78.0, 0.02, 0.0, 0.0, 0.0),
    "FOV": (130.0, 131.0, 101.0, 78.0, 0.7),
}
WIDTH, HEIGHT = 200, 160


def shade(directions: np.ndarray) -> np.ndarray:
    """A smooth colour of every direction (x, y over z)."""
    x, y = directions[..., 0], directions[..., 1]
    return np.stack([0.5 + 0.3 * np.sin(4 * x), 0.5 + 0.3 * np.cos(5 * y), 0.5 + 0.2 * np.sin(3 * (x + y))], -1)


def photograph(lens: Lens) -> np.ndarray:
    """What a lens shows of `shade`."""
    x, y = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    points = np.stack([x, y], -1).reshape(-1, 2)
    return shade(lens.directions(points).reshape(lens.height, lens.width, 2)).astype(np.float32)


def difference(lens: Lens, longest: int | None) -> float:
    """Largest difference of the resampled photograph from what the pinhole sees, without the outermost pixels."""
    _, pinhole = lens.target(longest)
    made = resampled(photograph(lens), lambda rows: rows, lens, longest)
    x, y = np.meshgrid(np.arange(pinhole.width) + 0.5, np.arange(pinhole.height) + 0.5)
    directions = (np.stack([x, y], -1) - pinhole.centre) / pinhole.focal
    assert made.shape == (pinhole.height, pinhole.width, 3)
    assert longest is None or max(pinhole.width, pinhole.height) <= longest
    return float(np.abs(made - shade(directions))[1:-1, 1:-1].max())


@pytest.mark.parametrize("longest", [None, 90])
@pytest.mark.parametrize("model", BENT)
def test_distortion_is_taken_away(model, longest):
    pytest.importorskip("pycolmap")
    lens = Lens(model, BENT[model], WIDTH, HEIGHT)
    assert difference(lens, longest) < (4e-3 if model == "OPENCV_FISHEYE" else 2e-3)  # it reduces its border more
    bent, straight = photograph(lens), photograph(Lens.pinhole(lens.focal, lens.centre, (WIDTH, HEIGHT)))
    assert np.abs(bent - straight).max() > 0.04  # so the test can fail


@pytest.mark.parametrize("longest", [None, 90, 77])
@pytest.mark.parametrize("focal", [(150.0, 153.0), (153.0, 150.0), (150.0, 150.0)])
def test_oblong_pixels_become_square(focal, longest):
    assert difference(Lens.pinhole(focal, (101.0, 78.0), (WIDTH, HEIGHT)), longest) < 2e-3


def test_pixels_that_are_nearly_square_stay_as_they_are():
    noise = np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    lens = Lens.pinhole((150.0, 150.1), (101.0, 78.0), (WIDTH, HEIGHT))
    np.testing.assert_array_equal(resampled(noise, lambda rows: rows, lens, None), noise)


def test_names_of_lenses_are_those_of_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    from jaxdr.views.layouts.colmap_tables import PARAMETERS

    for model in set(PARAMETERS) - {"EQUIRECTANGULAR"}:
        camera = pycolmap.Camera.create_from_model_name(1, model, 9.0, 8, 6)
        lens = Lens(model, tuple(camera.params.tolist()), 8, 6)
        assert len(camera.focal_length_idxs()) == (1 if model in ONE_FOCAL else 2), model
        assert lens.centre == (camera.principal_point_x, camera.principal_point_y), model


def test_means_over_areas():
    random = np.random.default_rng(0).random((37, 53, 2)).astype(np.float32)
    share = 0.31
    new = int(53 * share), int(37 * share)
    found = area_mean(lambda first, end: random[first:end], (53, 37), new, (share, share), 2)
    fine = random.astype(float).repeat(31, 0).repeat(31, 1)  # 31 parts of an old pixel, 100 of a new one
    exact = fine[: 100 * new[1], : 100 * new[0]].reshape(new[1], 100, new[0], 100, 2).mean((1, 3))
    np.testing.assert_allclose(found, exact, atol=1e-5)


def test_pictures_are_averaged_in_linear_light(tmp_path):
    folder = write_colmap(tmp_path, masks=False)
    stripes = np.zeros((SIZE, SIZE, 3), np.uint8)
    stripes[:, ::2] = 255
    for path in (folder / "images").iterdir():
        Image.fromarray(stripes).save(path)
    view = jd.load_views(folder, longest=8).views[0]
    assert (view.width, view.height, view.focal) == (8, 8, view.lens.focal[0] / 2)
    np.testing.assert_allclose(view.image, 0.5, atol=1e-6)


def test_what_is_transparent_has_no_share_in_a_mean(tmp_path):
    write_nerf(tmp_path)
    pixels = np.zeros((SIZE, SIZE, 4), np.uint8)
    pixels[:, ::2] = (255, 255, 255, 255)
    pixels[:, 1::2] = (0, 0, 0, 51)
    Image.fromarray(pixels).save(tmp_path / "train/r_0.png")
    view = jd.load_views(tmp_path, longest=8).views[0]
    np.testing.assert_allclose(view.alpha, 0.6, atol=1e-6)
    np.testing.assert_allclose(view.image, 1 / 1.2, atol=1e-6)


def test_nor_where_distortion_is_taken_away(tmp_path):
    pytest.importorskip("pycolmap")
    write_nerf(tmp_path, test=0)
    lens = Lens("OPENCV", (88.0, 88.0, 32.0, 32.0, 0.1, 0.0, 0.0, 0.0), 64, 64)
    edit_json(tmp_path / "transforms_train.json", lambda document: document.update(lens_entries(lens)))
    pixels = np.zeros((64, 64, 4), np.uint8)
    pixels[10:50, 10:50] = 255  # white, and transparent black around it
    for path in (tmp_path / "train").iterdir():
        Image.fromarray(pixels).save(path)
    view = jd.load_views(tmp_path).views[0]
    assert view.alpha is not None and ((view.alpha > 0.01) & (view.alpha < 0.99)).any()
    np.testing.assert_allclose(view.image[view.alpha > 1e-3], 1.0, atol=1e-3)


def test_several_sizes_and_cameras(tmp_path):
    write_nerf(tmp_path)
    write_picture(tmp_path / "train" / "r_3.png", size=2 * SIZE)
    views = jd.load_views(tmp_path).fitted
    assert [(view.width, view.focal) for view in views] == [(SIZE, views[0].focal)] * 3 + [
        (2 * SIZE, pytest.approx(2 * views[0].focal))
    ]


def test_a_smaller_picture_than_the_cameras(tmp_path):
    folder = write_colmap(tmp_path, masks=False)
    table = folder / "sparse/0/cameras.txt"
    table.write_text("1 OPENCV 64 64 88 88 32 32 .1 0 0 0\n")
    view = jd.load_views(folder).views[0]
    assert (view.lens.width, view.lens.height, view.lens.focal, view.lens.centre) == (16, 16, (22, 22), (8, 8))


@pytest.mark.parametrize("turn", range(1, 9))
def test_orientations_are_those_of_pillow(turn, tmp_path):
    from PIL import ImageOps

    pixels = np.random.default_rng(0).integers(0, 256, (3, 5, 3), np.uint8)
    picture = Image.fromarray(pixels)
    picture.getexif()[0x0112] = turn
    picture.save(tmp_path / "a.png", exif=picture.getexif())
    assert png.turn(tmp_path / "a.png") == turn and set(TURNS) == set(range(1, 9))
    upright = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / "a.png")))
    np.testing.assert_array_equal(turned(pixels, turn), upright)
    assert turned_size((5, 3), turn) == upright.shape[1::-1]
    np.testing.assert_array_equal(turned(upright, UNDONE.get(turn, turn)), pixels)


@pytest.mark.parametrize("upright_camera", [False, True])
@pytest.mark.parametrize("upright_mask", [False, True])
@pytest.mark.parametrize("turn", [6, 8])
def test_the_cameras_size_tells_which_picture_it_is_of(tmp_path, turn, upright_camera, upright_mask):
    """Colours, mask and camera agree, whichever of them is turned."""
    stored = np.zeros((12, 20, 3), np.uint8)
    stored[:4, :7] = 255
    mask = stored[..., 0]
    size = (12, 20) if upright_camera else (20, 12)
    frames = []
    for i, pose in enumerate(poses(2)):
        picture = Image.fromarray(stored)
        picture.getexif()[0x0112] = turn
        picture.save(tmp_path / f"{i}.jpg", quality=100, subsampling=0, exif=picture.getexif())
        (tmp_path / "mask").mkdir(exist_ok=True)
        Image.fromarray(turned(mask[..., None], turn)[..., 0] if upright_mask else mask).save(
            tmp_path / "mask" / f"{i}_mask.jpg", quality=100
        )
        frames.append({"file_path": f"{i}.jpg", "transform_matrix": (pose @ FROM_OPENGL).tolist()})
    write_json(tmp_path / "transforms.json", {"fl_x": 30.0, "w": size[0], "h": size[1], "frames": frames})
    view = jd.load_views(tmp_path).views[0]
    expected = turned(mask[..., None], turn if upright_camera else 1)[..., 0] / 255
    np.testing.assert_allclose(view.alpha, expected, atol=0.03)
    np.testing.assert_allclose(view.image[..., 0], expected, atol=0.03)


@pytest.mark.parametrize("upright_cameras", [False, True])
def test_pictures_upside_down_go_with_those_whose_size_tells(tmp_path, upright_cameras):
    """One picture that lies on its side tells whether the cameras heed EXIF, also in one that is upside down."""
    stored = np.random.default_rng(0).integers(0, 256, (12, 20, 3), np.uint8)
    frames = []
    for turn, pose in zip((6, 3), poses(2), strict=True):
        picture = Image.fromarray(stored)
        picture.getexif()[0x0112] = turn
        picture.save(tmp_path / f"{turn}.png", exif=picture.getexif())
        width, height = turned_size((20, 12), turn) if upright_cameras else (20, 12)
        frames.append({"file_path": f"{turn}.png", "transform_matrix": (pose @ FROM_OPENGL).tolist()})
        frames[-1] |= {"w": width, "h": height}
    write_json(tmp_path / "transforms.json", {"fl_x": 30.0, "frames": frames})
    for turn, view in zip((6, 3), jd.load_views(tmp_path).views, strict=True):
        np.testing.assert_array_equal(to_srgb(view.image), turned(stored, turn if upright_cameras else 1))


NAMES = ("masks/train_0.png", "masks/train_0.png.png", "mask/train_0.jpg", "masks/train_0_mask.png", "beside")


@pytest.mark.parametrize("name", NAMES)
def test_masks_under_the_names_that_people_give(tmp_path, name):
    folder = write_colmap(tmp_path, masks=False)
    for picture in sorted((folder / "images").glob("*.png")):
        to = "images/train_0_mask.jpeg" if name == "beside" else name
        path = folder / to.replace("train_0", picture.stem)
        path.parent.mkdir(exist_ok=True)
        Image.fromarray((255 * disc(2 * SIZE)).astype(np.uint8)).save(path, quality=100)  # and of another size
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        views = jd.load_views(folder)
    assert views.masked
    for view in views.views:
        assert view.mask is not None and view.picture.read()[1] is not None
        assert abs(np.asarray(view.alpha) - disc()).mean() < 0.05


def test_what_is_missing_or_left_over_is_said_and_left_out(tmp_path):
    folder = write_colmap(tmp_path, count=5)
    (folder / "images/train_0.png").unlink()
    (folder / "masks/train_1.png").unlink()
    Image.fromarray((255 * disc()).astype(np.uint8)).save(folder / "masks/train_9.png")
    with pytest.warns(UserWarning) as told:
        views = jd.load_views(folder)
    assert [view.name for view in views.views] == ["test_4", "train_2", "train_3"]
    said = " ".join(str(each.message) for each in told)
    assert "1 of 5 pictures are missing and left out: train_0.png" in said
    assert "1 of 4 photographs have no mask and are left out: train_1.png" in said
    assert "2 masks belong to no photograph and are not used, masks/train_0.png for one" in said


def test_masks_that_are_called_like_no_photograph_are_said(tmp_path):
    folder = write_colmap(tmp_path)
    for path in list((folder / "masks").iterdir()):
        path.rename(path.with_name(f"m{path.name}"))
    with pytest.warns(UserWarning, match="none of the 3 masks is called like a photograph"):
        assert not jd.load_views(folder).masked


@pytest.mark.parametrize("model", [*BENT, "PINHOLE"])
def test_lenses_are_written_as_they_are_read(tmp_path, model):
    pytest.importorskip("pycolmap")
    write_nerf(tmp_path, test=0)
    for i in range(4):
        write_picture(tmp_path / "train" / f"r_{i}.png", size=64)
    (tmp_path / "transforms_train.json").rename(tmp_path / "transforms.json")
    lens = Lens(model, BENT.get(model, (50.0, 51.0, 31.0, 33.0)), 64, 64)
    edit_json(tmp_path / "transforms.json", lambda document: document.update(lens_entries(lens)))
    found = jd.load_views(tmp_path).views[0].lens
    directions = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.0]])
    np.testing.assert_allclose(found.project(directions), lens.project(directions), atol=1e-9)
    assert (found.width, found.height) == (64, 64)
