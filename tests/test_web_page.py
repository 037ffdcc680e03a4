"""The pages of runs and charts: a browser loads nothing for them, whatever is in the files that they show."""

import numpy as np
import pytest

import jaxdr as jd
from jaxdr.chart.page import Section
from jaxdr.chart.page import page as chart_page
from jaxdr.optimize.reconstruction.config import ReconstructConfig
from jaxdr.optimize.reconstruction.output import OutputFolder
from jaxdr.optimize.reconstruction.page import page_row, report_page
from jaxdr.views.evaluate import Evaluation, Score
from jaxdr.web_page import content_policy
from tests.views.folders import SIZE, write_nerf

ATTACK = "</title><script src='https://example.org/x.js'></script><img src='https://example.org/x.png'>"


def of_chart(tmp_path) -> str:
    row = {"estimator": ATTACK, "samples": 4, "status": ATTACK, "seconds": 1.0}
    return chart_page(ATTACK, [ATTACK], [Section(ATTACK, [ATTACK], [], [(ATTACK, np.ones((2, 2, 3)))], [row], [], {})])


def of_reconstruction(tmp_path) -> str:
    views = jd.load_views(write_nerf(tmp_path))
    folder = OutputFolder(ReconstructConfig(folder=f"x{ATTACK}", output=str(tmp_path / "out")), views)
    score = Score(ATTACK, 30.0, 0.9, None)
    view = views.views[0].with_picture(np.ones((SIZE, SIZE, 3), np.float32), None)
    row = page_row(view, np.ones((SIZE, SIZE, 4), np.float32), score)
    return report_page([row], Evaluation((score,)), "held out", False, folder)


@pytest.mark.parametrize("make", [of_chart, of_reconstruction])
def test_pages_load_nothing_from_elsewhere(tmp_path, make):
    text = make(tmp_path)
    policy = content_policy()
    assert "default-src 'none'" in policy and "script-src" not in policy
    assert text.count(policy) == 1 and text.index(policy) < text.index("<title>")  # before all that it is about
    assert "<script" not in text and "<img src='https" not in text and "&lt;script" in text
