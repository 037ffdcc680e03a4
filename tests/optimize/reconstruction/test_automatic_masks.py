"""Masks of photographs that have none: where the object is, what is cut out, and what is said when it fails."""

import dataclasses
import struct
from pathlib import Path

import numpy as np
import pytest

import jaxdr as jd
from jaxdr.optimize.reconstruction.automatic_masks.consensus import agreed_solid, overlap, silhouette
from jaxdr.optimize.reconstruction.automatic_masks.find import find_masks, with_masks
from jaxdr.optimize.reconstruction.automatic_masks.region import find_region
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.scene.camera import look_at
from jaxdr.views.lens import Lens
from jaxdr.views.pictures import Pixels
from jaxdr.views.record import View, Views
from jaxdr.views.resample import in_file, resampled
from jaxdr.views.sparse_points import SparsePoints, sparse_points
from tests.views.folders import write_colmap

SIZE, COUNT, RADIUS = 96, 12, 0.5


def cameras() -> list[np.ndarray]:
    angles = 2 * np.pi * np.arange(COUNT) / COUNT
    return [look_at((3 * np.cos(a), 3 * np.sin(a), 1.2), (0, 0, 0), (0, 0, 1)) for a in angles]


def rays(pose: np.ndarray, focal: float) -> np.ndarray:
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
    local = np.stack([(SIZE / 2 - x) / focal, (SIZE / 2 - y) / focal, np.ones_like(x)], -1)
    world = local @ pose[:3, :3].T
    return world / np.linalg.norm(world, axis=-1, keepdims=True)


def ball(pose: np.ndarray, focal: float) -> np.ndarray:
    """Where a ball around the origin is."""
    directions, origin = rays(pose, focal), pose[:3, 3]
    along = -directions @ origin
    return origin @ origin - along**2 < RADIUS**2


def photographs() -> tuple[Views, list[np.ndarray]]:
    """A mottled red ball on a mottled grey floor, under a blue sky, and where the ball is."""
    random = np.random.default_rng(0)
    focal, views, masks = 1.2 * SIZE, [], []
    for number, pose in enumerate(cameras()):
        mask = ball(pose, focal)
        floor = rays(pose, focal)[..., 2] < -0.1
        color = np.where(floor[..., None], [0.3, 0.32, 0.3], [0.2, 0.3, 0.7])
        color = np.where(mask[..., None], [0.6, 0.15, 0.1], color) * random.uniform(0.7, 1.3, (SIZE, SIZE, 1))
        picture = Pixels(color.astype(np.float32))
        views.append(View(f"v{number}", Path(f"v{number}.png"), picture, pose, focal, (SIZE / 2, SIZE / 2)))
        masks.append(mask)
    return Views(Path(), tuple(views)), masks


def sparse(views: Views) -> SparsePoints:
    """Points on the ball, on the floor below it and far away; each photograph saw all that it shows."""
    random = np.random.default_rng(1)
    sphere = random.normal(size=(200, 3))
    sphere *= RADIUS / np.linalg.norm(sphere, axis=1, keepdims=True)
    floor = np.concatenate([random.uniform(-1.5, 1.5, (300, 2)), random.normal(-RADIUS, 0.01, (300, 1))], 1)
    far = random.normal(size=(100, 3)) * 4 + [0, 0, 3]
    return SparsePoints(np.concatenate([sphere, floor, far]), np.ones((len(views.views), 600), bool))


def test_the_region_is_above_what_the_object_stands_on():
    views, _ = photographs()
    points = sparse(views)
    region = find_region(views.views, points, 0)
    assert np.linalg.norm(region.centre) < 0.3 and 0.4 < region.radius < 1.5
    assert region.support is not None
    assert region.support.normal @ [0, 0, 1] > 0.999 and abs(region.support.point[2] + RADIUS) < 0.05
    assert region.own[:200].mean() > 0.8 and not region.own[200:500].any() and not region.others[:160].all()
    assert region.others[200:500].mean() > 0.9
    assert find_region(views.views, points, 0).radius == region.radius


@pytest.mark.parametrize("with_points", [False, True])
def test_masks_of_a_ball(monkeypatch, with_points):
    pytest.importorskip("cv2")
    views, masks = photographs()
    points = sparse(views) if with_points else None
    monkeypatch.setattr("jaxdr.optimize.reconstruction.automatic_masks.find.sparse_points", lambda views: points)
    said: list[str] = []
    found = find_masks(views, 0, said.append)
    shares = [overlap(*both) for both in zip(found.masks, masks, strict=True)]
    # The lowest part of the ball is as low as points of the floor may be.
    assert min(shares) > (0.8 if with_points else 0.93) and all(found.good) and found.to_dict()["left_out"] == 0
    assert len(said) == 4
    corners = np.asarray(found.solid.vertices)
    assert np.abs(np.linalg.norm(corners, axis=1) - RADIUS).max() < 0.15
    again = find_masks(views, 0, said.append)
    assert all((one == other).all() for one, other in zip(found.masks, again.masks, strict=True))
    cut = with_masks(views, found)
    assert cut.masked and all((view.alpha == mask).all() for view, mask in zip(cut.views, found.masks, strict=True))


def test_a_bad_mask_is_left_out(monkeypatch):
    pytest.importorskip("cv2")
    views, _ = photographs()
    spoilt = dataclasses.replace(views.views[3], picture=Pixels(np.full((SIZE, SIZE, 3), 0.2, np.float32)))
    views = dataclasses.replace(views, views=(*views.views[:3], spoilt, *views.views[4:]))
    monkeypatch.setattr("jaxdr.optimize.reconstruction.automatic_masks.find.sparse_points", lambda views: None)
    from jaxdr.optimize.reconstruction.automatic_masks import find

    original = find.cut_out
    monkeypatch.setattr(find, "cut_out", lambda view, *rest: original(view, *rest) & (view.name != "v3"))
    found = find_masks(views, 0, lambda text: None)
    assert found.good == [view.name != "v3" for view in views.views]
    assert [view.name for view in with_masks(views, found).views] == [f"v{i}" for i in range(COUNT) if i != 3]


def test_photographs_that_agree_on_nothing_are_told(monkeypatch):
    pytest.importorskip("cv2")
    from jaxdr.optimize.reconstruction.automatic_masks import find

    views, _ = photographs()
    monkeypatch.setattr(find, "sparse_points", lambda views: None)
    monkeypatch.setattr(find, "cut_out", lambda view, *rest: np.zeros((SIZE, SIZE), bool))
    with pytest.raises(ValueError, match="no masks were found: the photographs agree on no object; make masks with"):
        find_masks(views, 0, lambda text: None)


def test_the_solid_is_closed_and_faces_outward():
    views, masks = photographs()
    solid = agreed_solid(views.views, masks, find_region(views.views, None, 0))
    corners = np.asarray(solid.vertices)[np.asarray(solid.faces)]
    volume = np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    # A hull of twelve photographs is a little larger than the ball.
    assert 1.0 < volume / (4 / 3 * np.pi * RADIUS**3) < 1.4
    pytest.importorskip("cv2")
    assert (
        min(overlap(silhouette(*each), mask) for *each, mask in zip(views.views, [solid] * COUNT, masks, strict=True))
        > 0.8
    )


def test_masks_go_back_to_the_pixels_of_a_file():
    pytest.importorskip("pycolmap")
    lens = Lens("OPENCV", (150.0, 155.0, 101.0, 78.0, -0.2, 0.05, 0.003, -0.002), 200, 160)
    pinhole = lens.target(100)[1]
    y, x = np.mgrid[0 : pinhole.height, 0 : pinhole.width]
    mask = np.hypot(x - 45, y - 35) < 25
    back = in_file(mask, lens, 100)
    assert abs(back.shape[1] - 100) <= 15 and back.shape != mask.shape
    again = resampled(back[..., None].astype(np.float32), lambda rows: rows, lens, 100)[..., 0] > 0.5
    assert overlap(again, mask) > 0.97


@pytest.mark.parametrize("binary", [False, True])
def test_sparse_points_of_a_model(tmp_path, binary):
    folder = write_colmap(tmp_path, count=4, test=0, masks=False)
    model = folder / "sparse/0"
    assert sparse_points(jd.load_views(folder)) is None
    tracks = [(1, 2), (1, 2, 3), (1, 2, 3)]
    rows = [(i + 1, (i + 0.5, 2.0, -3.0), track) for i, track in enumerate(tracks)]
    if binary:
        data = struct.pack("<Q", len(rows))
        for number, position, track in rows:
            data += struct.pack("<Q3d3BdQ", number, *position, 255, 0, 0, 0.5, len(track))
            data += b"".join(struct.pack("<II", image, 0) for image in track)
        (model / "points3D.bin").write_bytes(data)
    else:
        lines = [
            f"{number} {' '.join(map(str, position))} 255 0 0 .5 {' '.join(f'{image} 0' for image in track)}\n"
            for number, position, track in rows
        ]
        (model / "points3D.txt").write_text("# points\n" + "".join(lines))
    found = sparse_points(jd.load_views(folder))
    assert found is not None
    np.testing.assert_allclose(found.positions, [[1.5, 2, -3], [2.5, 2, -3]])  # two saw the first: too few
    np.testing.assert_array_equal(found.saw, np.array([[True, True]] * 3 + [[False, False]]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", "line 1: a point needs an id"),
        ("1 x 2 3 0 0 0 .5 1 0 2 0 3 0\n", "line 1: expected a number, got 'x'"),
        ("1 nan 2 3 0 0 0 .5 1 0 2 0 3 0\n", "line 1: must be a finite number"),
        ("1 1 2 3 0 0 0 .5 one 0\n", "line 1"),
    ],
)
def test_damaged_points_are_told(tmp_path, text, message):
    folder = write_colmap(tmp_path, masks=False)
    (folder / "sparse/0/points3D.txt").write_text(text)
    with pytest.raises(ValueError, match=r"points3D\.txt: ") as caught:
        sparse_points(jd.load_views(folder))
    assert message in str(caught.value)


def test_a_cut_off_binary_table_of_points_is_told(tmp_path):
    folder = write_colmap(tmp_path, masks=False)
    (folder / "sparse/0/points3D.bin").write_bytes((2**40).to_bytes(8, "little") + b"\0" * 60)
    with pytest.raises(ValueError, match=r"points3D\.bin: .* bytes"):
        sparse_points(jd.load_views(folder))


def test_masks_are_written_and_can_be_given_back(tmp_path):
    from jaxdr.optimize.reconstruction.config import reconstruct_config

    folder = write_colmap(tmp_path / "photos", masks=False)
    views = jd.load_views(folder, longest=8)
    mask = np.zeros((8, 8), bool)
    mask[2:6, 3:7] = True
    cut = [dataclasses.replace(view, picture=view.picture.cut_by(mask)) for view in views.views]
    config = reconstruct_config({}, "", str(folder), str(tmp_path / "out"))
    output = OutputFolder(config, Views(folder, tuple(cut)))
    with output.opened(resume=False, overwrite=False):
        output.save_masks(cut)
    assert {output.mask(view) for view in cut} == set((tmp_path / "out/masks").iterdir())
    again = jd.load_views(folder, longest=8, masks=tmp_path / "out/masks")
    assert all((np.asarray(view.alpha) == mask).all() for view in again.views)
    with pytest.raises(ValueError, match="is not a folder; expected one with masks"):
        jd.load_views(folder, masks=tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="empty: has no mask of any photograph"):
        jd.load_views(folder, masks=tmp_path / "empty")
