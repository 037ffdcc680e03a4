"""`guide_report`: bytes within the bounds that docs/guided_edges.md promises, seconds, and its error."""

import pytest

import jaxdr as jd
from tests.gradients.floor_patch import scene
from tests.gradients.floor_point import QUADRANGLE, sheet

# Bytes in float32 of one strategy.
BOUNDS = [
    (jd.GuidedEdges("none", "emitter"), 0),
    (jd.GuidedEdges("grid", "emitter", cells=(64, 4, 4)), 4 * (64 + 64 * 4 + 64 * 4 * 4)),
    (jd.GuidedEdges("kdtree", "emitter", leaves=512), 170 * 512),
    (jd.GuidedEdges("projective", "emitter", leaves=512), 70 * 128),
]


@pytest.mark.parametrize(("boundary", "most"), BOUNDS, ids=lambda x: getattr(x, "guide", ""))
def test_bytes_are_bounded(boundary, most):
    report = jd.guide_report(scene(sheet(QUADRANGLE, 0.1)), boundary, moving=("blocker",))
    assert 0.5 * most <= report.bytes <= most
    assert report.first_seconds >= report.seconds > 0
    assert len(report.unguided) == 1 and 0.099 < report.unguided[0] <= 1.0


def test_unknown_name():
    with pytest.raises(ValueError, match="moving names 'ball', but the scene's shapes are blocker, floor, light"):
        jd.guide_report(scene(sheet(QUADRANGLE, 0.1)), jd.GuidedEdges(), moving=("ball",))
