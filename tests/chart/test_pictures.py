"""Pictures beside the page of a chart."""

import numpy as np

from jaxdr.chart.figure import COLORS, MARKERS, chart_png
from jaxdr.chart.pictures import MAP, images_picture, nearest_vertices, vertices_picture
from jaxdr.geometry.shapes import sphere
from jaxdr.images import POSITIVE, ZERO


def test_pixels_of_the_map_have_the_nearest_vertex():
    vertices = np.asarray(sphere(2, center=(3.0, 0.0, 1.0)).vertices, float)
    numbers = nearest_vertices(vertices)
    arms = vertices[numbers] - (3.0, 0.0, 1.0)
    assert numbers.shape == (MAP, 2 * MAP) and set(numbers.flat) == set(range(len(vertices)))
    assert arms[0, :, 2].min() > 0.9 and arms[-1, :, 2].max() < -0.9  # north is on top
    assert arms[MAP // 2, MAP, 0] > 0.9 and arms[MAP // 2, MAP + MAP // 2, 1] > 0.9


def test_maps_share_their_colours_and_what_is_not_finite_is_black():
    vertices = np.asarray(sphere(1).vertices, float)
    one, zero, bad = np.zeros((3, len(vertices), 3))
    one[:, 2] = 2.0
    bad[0] = np.nan
    picture = vertices_picture(vertices, {"one": one, "zero": zero, "bad": bad})
    row = picture[picture.shape[0] // 2]
    third = len(row) // 3
    for place, color in ((0, POSITIVE), (1, ZERO), (2, np.zeros(3))):
        np.testing.assert_array_equal(row[third * place + third // 2], np.round(255 * color))


def test_columns_of_images():
    reference = np.ones((16, 16, 3))
    picture = images_picture(reference, {"a": [reference, -reference], "b": [reference]})
    assert picture.shape[1] > 3 * 128 and picture.shape[0] > 2 * 128


def test_lines_go_on_as_means_of_more_calls(monkeypatch):
    """With slope -1/2 to the bias, and no further than asked; lines of an eleventh method have a look of their own."""
    from matplotlib.axes import Axes

    drawn, loglog = [], Axes.loglog
    monkeypatch.setattr(Axes, "loglog", lambda self, *args, **kw: drawn.append((args, kw)) or loglog(self, *args, **kw))
    point = {"samples": 4, "seconds": 0.5, "rmse": 0.5, "noise": 0.01, "bias2": 0.09, "deviation": 0.4}
    rows = [{"estimator": f"method {i}", **point} for i in range(12)]
    assert chart_png("a scene", rows, until=50.0)
    dashed = [args for args, _ in drawn if args[-1] == "--"]
    assert len(dashed) == 12
    for seconds, error, _ in dashed:
        assert seconds[0] == 0.5 and np.isclose(seconds[-1], 50.0)
        np.testing.assert_allclose(error**2, 0.09 + 0.16 * 0.5 / seconds)
    looks = {(args[-1], kw["color"]) for args, kw in drawn if "label" in kw and kw["label"].startswith("method")}
    assert len(looks) == 12 and len(set(MARKERS)) == len(MARKERS) == len(set(COLORS))
