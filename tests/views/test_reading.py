"""Pictures that are kept as far as they fit, and read ahead by threads."""

import threading
import time

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.optimize.reconstruction.pictures import Pose, cuts
from jaxdr.optimize.reconstruction.sky import find_backdrop
from jaxdr.views import pictures
from jaxdr.views.pictures import CannotRead
from jaxdr.views.reading import AHEAD, Kept, read_ahead
from tests.views.folders import SIZE, tell_apart, write_colmap, write_nerf, write_picture

WHERE = Pose(np.zeros(3), 1.0)
BYTES = SIZE * SIZE * 4 * 4  # of a picture with alpha


def test_as_many_as_fit_are_kept_and_the_first_ones_stay():
    kept, made = Kept(250), []

    def make(i):
        return lambda: (made.append(i), np.zeros(25, np.float32))[1]

    for _ in range(2):
        for i in range(4):
            kept.get(i, make(i))
    assert made == [0, 1, 2, 3, 2, 3] and kept.bytes == 200
    kept.clear()
    assert kept.bytes == 0 and 0 not in kept


def test_reading_ahead_keeps_the_order_and_stays_a_few_ahead():
    running, most, lock = set(), [0], threading.Lock()
    done = []

    def make(i):
        with lock:
            running.add(i)
            most[0] = max(most[0], i - len(done))
        time.sleep(0.002 * (i % 3))
        return i

    for value in read_ahead(make, range(30)):
        done.append(value)
        time.sleep(0.002)
    assert done == list(range(30)) and most[0] <= AHEAD


def test_what_goes_wrong_in_a_thread_comes_out():
    def make(i):
        if i == 3:
            raise CannotRead("r_3.png: is damaged")
        return i

    with pytest.raises(CannotRead, match=r"r_3\.png"):
        list(read_ahead(make, range(9)))


@pytest.fixture
def counted(monkeypatch):
    read, original = [], pictures.load_stored
    monkeypatch.setattr(pictures, "load_stored", lambda path: (read.append(path.name), original(path))[1])
    return read


def test_pixels_are_read_when_they_are_asked_for_and_once(tmp_path, counted):
    views = jd.load_views(write_nerf(tmp_path))
    assert len(counted) <= AHEAD  # whether alpha says anything at all
    for _ in range(3):
        for view in views.views:
            assert view.image.shape == (SIZE, SIZE, 3) and view.alpha.any()
    assert len(counted) == 6
    with pytest.raises(ValueError, match="read-only"):
        views.views[0].image[0] = 0


def test_with_room_for_one_picture_the_others_are_read_again(tmp_path, counted):
    views = jd.load_views(write_nerf(tmp_path), keep=BYTES / 2**30)
    counted.clear()
    for _ in range(3):
        for view in views.views:
            view.over_black  # noqa: B018
    assert len(counted) == 5 * 3


@pytest.mark.parametrize("make", [write_nerf, write_colmap])
def test_levels_and_sky_do_not_depend_on_the_room(tmp_path, make):
    if make is write_colmap:
        pytest.importorskip("pycolmap")
    folder = tell_apart(make(tmp_path))
    found = []
    for keep in (1.0, BYTES / 2**30, 0.0):
        views = jd.load_views(folder, keep=keep).views
        photographs = cuts(views, WHERE, SIZE // 2, int(keep * 2**30))
        photographs.expect([2, 0, 2])
        found.append(([photographs[i] for i in (0, 2, 1)], list(photographs), find_backdrop(views, 5)))
    for single, together, sky in found[1:]:
        for one, other in zip([*single, *together], [*found[0][0], *found[0][1]], strict=True):
            for part, same in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
                np.testing.assert_array_equal(part, same)
        if sky is None:
            assert found[0][2] is None
        else:
            for part, same in zip(sky, found[0][2], strict=True):
                np.testing.assert_array_equal(part, same)


def test_those_expected_are_read_ahead_and_others_are_let_go(tmp_path, counted):
    views = jd.load_views(tell_apart(write_nerf(tmp_path)), keep=0.0).views
    photographs = cuts(views, WHERE, SIZE)
    expected = [cut.color for cut in photographs]
    counted.clear()
    photographs.expect([3, 1])
    for number in (3, 1, 3, 3):
        np.testing.assert_array_equal(photographs[number].color, expected[number])
    assert len(counted) == 2
    photographs.expect([1, 2])
    photographs[1], photographs[2]
    assert len(counted) == 3
    photographs.expect(())
    photographs[1]
    assert len(counted) == 4


def test_a_picture_that_was_changed_meanwhile_is_told(tmp_path):
    views = jd.load_views(write_nerf(tmp_path, alpha=False)).views
    write_picture(views[2].path, size=SIZE + 2, alpha=False)
    with pytest.raises(CannotRead, match=r"r_2\.png: is another picture than its header said"):
        views[2].image  # noqa: B018


def test_an_object_too_small_for_a_level_is_told(tmp_path):
    from PIL import Image

    write_nerf(tmp_path)
    pixels = np.zeros((SIZE, SIZE, 4), np.uint8)
    pixels[3, 3] = 255
    Image.fromarray(pixels).save(tmp_path / "train" / "r_2.png")
    views = jd.load_views(tmp_path).views
    with pytest.raises(ValueError, match=r"r_2\.png: the object is so small that nothing of it is left with 4 pixels"):
        cuts(views, WHERE, 4)
