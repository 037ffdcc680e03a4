"""The pages of runs and charts: a browser loads nothing for them, whatever is in the files that they show."""

import json

import numpy as np
import pytest
from PIL import Image

from jaxdr.chart.page import Section
from jaxdr.chart.page import page as chart_page
from jaxdr.view.folder import read_folder
from jaxdr.view.page import page as run_page
from jaxdr.web_page import content_policy

ATTACK = "</title><script src='https://example.org/x.js'></script><img src='https://example.org/x.png'>"


def of_chart(tmp_path) -> str:
    row = {"estimator": ATTACK, "samples": 4, "status": ATTACK, "seconds": 1.0}
    return chart_page(ATTACK, [ATTACK], [Section(ATTACK, [ATTACK], [], [(ATTACK, np.ones((2, 2, 3)))], [row], [], {})])


def of_reconstruction(tmp_path) -> str:
    run, name = tmp_path / "<script src=x.js>", "<script src=y.js>"
    (run / "compared").mkdir(parents=True)
    Image.new("RGB", (4, 4)).save(run / "compared" / f"{name}.png")
    (run / "config.json").write_text(json.dumps({"unknown": ATTACK}))
    views = [{"name": name, "psnr": 30.0, "ssim": ATTACK}]
    (run / "metrics.json").write_text(json.dumps({"judged_by": ATTACK, "views": views}))
    return run_page(read_folder(run))


@pytest.mark.parametrize("make", [of_chart, of_reconstruction])
def test_pages_load_nothing_from_elsewhere(tmp_path, make):
    text = make(tmp_path)
    policy = content_policy()
    assert "default-src 'none'" in policy and "script-src" not in policy
    assert text.count(policy) == 1 and text.index(policy) < text.index("<title>")  # before all that it is about
    assert "<script" not in text and "<img src='https" not in text and "&lt;script" in text
