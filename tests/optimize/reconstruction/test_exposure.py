"""Exposures of photographs: found from colours and from EXIF, and taken away before paint and sky are found."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from jaxdr.geometry import shapes
from jaxdr.optimize.reconstruction.exposure import first_exposures, seen_exposures, told_exposures
from jaxdr.optimize.reconstruction.paint import seen_colors
from jaxdr.optimize.reconstruction.pictures import Photographs, Pose, cuts
from jaxdr.optimize.reconstruction.sky import find_backdrop
from jaxdr.views.pictures import Pixels
from jaxdr.views.record import View
from tests.optimize.reconstruction.test_sky import background_views
from tests.optimize.reconstruction.test_start import CENTRE, RADIUS, all_around

POSE, BALL = Pose(CENTRE, 2 * RADIUS), shapes.sphere(3, radius=0.5).smooth()
GAINS = np.random.default_rng(3).normal(0, 0.25, (24, 3))
GAINS -= GAINS.mean(0)


def paint(point) -> np.ndarray:
    return np.array([0.2, 0.25, 0.3]) * (1 + 0.5 * np.sin(9 * point[0]) * np.cos(7 * point[2]))


def exposed(views: list[View]) -> list[View]:
    pictures = (
        Pixels((view.image * np.exp(gain)).astype(np.float32), view.alpha)
        for view, gain in zip(views, GAINS, strict=False)
    )
    return [dataclasses.replace(view, picture=picture) for view, picture in zip(views, pictures, strict=True)]


def photographs(views) -> Photographs:
    return cuts(views, POSE, 64)


def with_exif(views: list[View], folder, exposures) -> list[View]:
    """The photographs with files whose EXIF tells exposures: time, sensitivity and f-number take part."""
    made = []
    for number, (view, exposure) in enumerate(zip(views, exposures, strict=True)):
        speed, stop = 100 * 2 ** (number % 3), 1.8 + number % 2
        exif = Image.Exif()
        exif.get_ifd(0x8769).update({33434: float(np.exp(exposure)) / speed * stop**2, 33437: stop, 34855: speed})
        path = folder / f"{number}.jpg"
        Image.new("RGB", (4, 4)).save(path, exif=exif)
        made.append(dataclasses.replace(view, path=path))
    return made


def test_colours_of_the_same_points_tell_exposures():
    views = all_around(paint=paint)
    np.testing.assert_allclose(seen_exposures(BALL, photographs(exposed(views))), GAINS, atol=0.02)
    np.testing.assert_allclose(seen_exposures(BALL, photographs(views)), 0, atol=0.02)


def test_exif_tells_exposures_if_every_file_has_it(tmp_path):
    views = with_exif(all_around(), tmp_path, GAINS[:, 0])
    np.testing.assert_allclose(told_exposures(views), GAINS[:, 0], atol=1e-4)
    Image.new("RGB", (4, 4)).save(views[3].path)
    assert told_exposures(views) is None
    assert told_exposures(all_around()) is None  # no files


def test_the_start_is_that_of_exif_where_it_explains_the_colours(tmp_path):
    views = all_around(paint=paint)
    assert not first_exposures(BALL, photographs(views))[0].any()
    seen, line = first_exposures(BALL, photographs(exposed(views)))
    np.testing.assert_allclose(seen, GAINS, atol=0.02)
    assert "differ in exposure" in line and "EXIF" not in line
    right = photographs(with_exif(exposed(views), tmp_path, GAINS.mean(1)))
    told, line = first_exposures(BALL, right)
    np.testing.assert_allclose(told, np.repeat(GAINS.mean(1)[:, None], 3, 1), atol=1e-4)
    assert "EXIF" in line
    wrong = photographs(with_exif(exposed(views), tmp_path, -GAINS.mean(1)))
    np.testing.assert_allclose(first_exposures(BALL, wrong)[0], seen)
    # Photographs that agree have one exposure, whatever EXIF says: a lamp may have been turned up.
    assert not first_exposures(BALL, photographs(with_exif(views, tmp_path, GAINS.mean(1))))[0].any()
    # Without a surface nothing else is known.
    np.testing.assert_allclose(first_exposures(None, right)[0], told)


def test_paint_and_sky_are_found_without_the_exposures():
    views = all_around(paint=paint)
    same = photographs(exposed(views)).with_corrections(None, GAINS)
    expected = seen_colors(BALL, photographs(views))
    np.testing.assert_allclose(seen_colors(BALL, same), expected, rtol=1e-4, atol=1e-6)
    assert np.abs(seen_colors(BALL, photographs(exposed(views))) - expected).max() > 0.02
    skies = background_views()
    plain, found = find_backdrop(skies, 9), find_backdrop(exposed(skies), 9, GAINS[: len(skies)])
    assert plain is not None and found is not None
    np.testing.assert_allclose(found.radiance, plain.radiance, rtol=1e-4)


@pytest.mark.parametrize("spoiled", ["no numbers", "no picture"])
def test_files_without_exif_are_no_error(tmp_path, spoiled):
    views = with_exif(all_around(), tmp_path, GAINS[:, 0])
    if spoiled == "no picture":
        views[0].path.write_bytes(b"not a picture")
    else:
        exif = Image.Exif()
        exif.get_ifd(0x8769).update({33434: 0.0, 33437: 1.8, 34855: 100})
        Image.new("RGB", (4, 4)).save(views[0].path, exif=exif)
    assert told_exposures(views) is None
