"""Reading photographs with known cameras: layouts, conventions, held-out pictures."""

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.images import from_srgb
from tests.views.folders import (
    FOCAL,
    FOV,
    SIZE,
    disc,
    edit_json,
    poses,
    write_colmap,
    write_json,
    write_nerf,
    write_picture,
)


def test_nerf_synthetic(tmp_path):
    views = jd.load_views(write_nerf(tmp_path))
    assert [view.name for view in views.fitted] == ["r_0", "r_1", "r_2", "r_3"]
    assert [view.name for view in views.held_out] == ["r_0", "r_1"]
    view = views.fitted[1]
    assert view.path == tmp_path / "train" / "r_1.png"
    np.testing.assert_allclose(view.to_world, poses(4)[1], atol=1e-12)
    np.testing.assert_allclose([view.focal, view.fov, *view.centre], [FOCAL, FOV, SIZE / 2, SIZE / 2])
    np.testing.assert_allclose(view.image, from_srgb(np.full((SIZE, SIZE, 3), 128 / 255)), rtol=1e-6)
    np.testing.assert_array_equal(view.alpha, disc())
    assert views.masked


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_PINHOLE"])
def test_colmap(tmp_path, binary, model):
    pycolmap = pytest.importorskip("pycolmap")
    folder = write_colmap(tmp_path, model=model)
    if binary:
        pycolmap.Reconstruction(str(folder / "sparse/0")).write_binary(str(folder / "sparse/0"))
        for path in (folder / "sparse/0").glob("*.txt"):
            path.unlink()
    views = jd.load_views(folder)
    assert [view.name for view in views.fitted] == ["train_0", "train_1"]
    assert [view.name for view in views.held_out] == ["test_2"]
    for view, pose in zip((*views.fitted, *views.held_out), poses(3), strict=True):
        np.testing.assert_allclose(view.to_world, pose, atol=1e-8)
        np.testing.assert_allclose([view.focal, *view.centre], [FOCAL, 8, 8], rtol=1e-6)
        np.testing.assert_array_equal(view.alpha, disc())


def test_intrinsics_of_a_frame_win_and_the_principal_point_lands_where_it_is_said(tmp_path):
    write_nerf(tmp_path, test=0)
    (tmp_path / "transforms_train.json").rename(tmp_path / "transforms.json")

    def change(document):
        document.update(fl_x=20.0, fl_y=20.0, cx=8.0, cy=8.0, w=SIZE, h=SIZE)
        document["frames"][2].update(fl_x=30.0, fl_y=30.0, cx=5.0, cy=9.0)

    edit_json(tmp_path / "transforms.json", change)
    views = jd.load_views(tmp_path).views
    assert [view.focal for view in views] == [20, 20, 30, 20]
    view = views[2]
    ahead = view.to_world[:3, 3] + view.to_world[:3, 2]
    np.testing.assert_allclose(view.camera.project(jnp.asarray(ahead)), [5, 9], atol=1e-4)
    # A point one unit to the right at depth one lies a focal length to the right.
    np.testing.assert_allclose(view.camera.project(jnp.asarray(ahead - view.to_world[:3, 0])), [35, 9], atol=1e-4)
    np.testing.assert_allclose(view.camera.project(jnp.asarray(ahead + view.to_world[:3, 1])), [5, -21], atol=1e-4)


def test_linear_formats_and_masks_by_path(tmp_path):
    frames = []
    for i, pose in enumerate(poses(3)):
        np.save(tmp_path / f"{i}.npy", np.full((SIZE, SIZE, 3), 3.5, np.float32))
        Image.fromarray((255 * disc()).astype(np.uint8)).save(tmp_path / f"mask{i}.png")
        matrix = (pose @ np.diag([-1.0, 1, -1, 1])).tolist()
        frames.append({"file_path": f"{i}.npy", "mask_path": f"mask{i}.png", "transform_matrix": matrix})
    write_json(tmp_path / "transforms.json", {"fl_x": FOCAL, "frames": frames})
    views = jd.load_views(tmp_path).views
    assert (views[0].image == 3.5).all() and (views[2].alpha == disc()).all()
    assert not any(view.held_out for view in views)  # fewer than eight


def test_exr_colours_are_divided_by_alpha(tmp_path):
    exr = pytest.importorskip("jaxdr.image_formats.exr")
    if not exr.is_available():
        pytest.skip("OpenEXR is not installed")
    write_nerf(tmp_path, train=2, test=0)
    pixels = np.dstack([np.full((SIZE, SIZE, 3), 1.5), np.full((SIZE, SIZE), 0.75)]).astype(np.float32)
    for i in range(2):
        (tmp_path / "train" / f"r_{i}.png").unlink()
        exr.write(tmp_path / "train" / f"r_{i}.exr", pixels)
    view = jd.load_views(tmp_path).views[0]
    np.testing.assert_allclose(view.image, 2.0)
    np.testing.assert_allclose(view.over_black, 1.5)


def test_without_alpha_there_are_no_masks(tmp_path):
    views = jd.load_views(write_nerf(tmp_path, alpha=False))
    assert not views.masked and views.views[0].alpha is None


def test_opaque_alpha_everywhere_is_no_mask(tmp_path):
    write_nerf(tmp_path, train=2, test=0)
    for i in range(2):
        Image.fromarray(np.full((SIZE, SIZE, 4), 255, np.uint8)).save(tmp_path / "train" / f"r_{i}.png")
    assert jd.load_views(tmp_path).views[0].alpha is None


def test_held_out_by_pattern_and_every_eighth(tmp_path):
    write_nerf(tmp_path, train=9, test=0)
    names = [view.name for view in jd.load_views(tmp_path).held_out]
    assert names == ["r_0", "r_8"]
    names = [view.name for view in jd.load_views(tmp_path, holdout="*_[12]").held_out]
    assert names == ["r_1", "r_2"]
    names = [view.name for view in jd.load_views(tmp_path, holdout="train/r_3*").held_out]
    assert names == ["r_3"]


def test_a_pattern_adds_to_the_test_pictures(tmp_path):
    write_nerf(tmp_path)
    held = jd.load_views(tmp_path, holdout="train/r_3.png").held_out
    assert [view.path.relative_to(tmp_path).as_posix() for view in held] == [
        "train/r_3.png",
        "test/r_0.png",
        "test/r_1.png",
    ]


def test_frames_say_themselves_that_they_are_held_out(tmp_path):
    """As `jaxdr reconstruct` writes its cameras."""
    write_nerf(tmp_path, train=3, test=0)
    edit_json(
        tmp_path / "transforms_train.json",
        lambda document: [frame.update(held_out=i == 1) for i, frame in enumerate(document["frames"])],
    )
    assert [view.name for view in jd.load_views(tmp_path).held_out] == ["r_1"]


def test_names_that_collide_get_their_folders(tmp_path):
    write_nerf(tmp_path, train=2, test=0)
    write_picture(tmp_path / "more" / "r_0.png")

    def change(document):
        document["frames"].append({**document["frames"][1], "file_path": "more/r_0"})

    edit_json(tmp_path / "transforms_train.json", change)
    assert [view.name for view in jd.load_views(tmp_path).views] == ["train_r_0", "train_r_1", "more_r_0"]
