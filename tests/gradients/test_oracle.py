"""The reference scenes, compared by their own `check.py` at a lower sample count.

Its tolerances are kept; what fewer samples add is allowed for by the standard error it reports.
"""

import argparse
import json
from functools import partial

import pytest

import jaxdr as jd
from experiments.data.reference_scenes import check, cornell_box

# Samples per pixel of the quick version, all keys together, and the standard error of the projection it must reach.
CASES = {
    ("direct_spot", "translate_x"): (64, 0.03),
    ("direct_spot", "rotate_z"): (64, 0.03),
    ("shadow_goathead", "translate_x"): (128, 0.03),
    ("cornell_indirect", "translate_x"): (512, 0.08),
    ("cube_constant", "translate_z"): (64, 0.03),
    ("environment_penguin", "rotate_z"): (1024, 0.03),
    ("environment_penguin", "rotate_environment_z"): (256, 0.03),
}


def compare(case, name, spp, keys, boundary="KernelDensity"):
    folder = check.ROOT / case
    oracle = json.loads((folder / "oracle.json").read_text())
    parameter = next(p for p in oracle["parameters"] if p["name"] == name)
    options = argparse.Namespace(spp=spp, keys=keys, boundary=boundary, bidirectional=False, seed=0)
    return check.compare(folder, oracle, parameter, *check.estimate(folder, oracle, parameter, options))


@pytest.mark.parametrize("name", cornell_box.WALLS)
def test_walls_are_those_that_their_script_writes(name):
    assert (cornell_box.FOLDER / f"{name}.obj").read_text() == cornell_box.obj(cornell_box.WALLS[name])


QUICK = (("direct_spot", "KernelDensity"), ("shadow_goathead", "LineSampling"), ("cube_constant", "LineSampling"))


def cases():
    """Every case with both estimators; each case once by default, the rest and what takes long with -m slow."""
    both = [(*case, boundary) for case in CASES for boundary in ("KernelDensity", "LineSampling")]
    quick = [name != "rotate_z" and (case, boundary) in QUICK for case, name, boundary in both]
    return [pytest.param(*row, marks=[] if q else [pytest.mark.slow]) for row, q in zip(both, quick, strict=True)]


@pytest.mark.parametrize(("case", "name", "boundary"), cases())
def test_quick(case, name, boundary):
    passes(compare(case, name, CASES[case, name][0], keys=8, boundary=boundary), CASES[case, name][1])


def passes(row, deviation):
    """`check`'s own tolerances, and what few samples add."""
    assert row["projection_error"] < deviation, "too few samples to tell"
    assert row["primal"] < check.PRIMAL_TOLERANCE
    assert abs(row["projection"] - 1) < check.PROJECTION_TOLERANCE + 3 * row["projection_error"]
    assert row["passed"] or abs(row["projection"] - 1) > check.PROJECTION_TOLERANCE, f"mean gradient: {row['mean']:.1%}"


@pytest.mark.slow
@pytest.mark.parametrize("guide", ["none", "grid", "kdtree", "projective"])
@pytest.mark.parametrize(("case", "name"), [*CASES, ("mirror_spot", "translate_y")])
def test_guides(monkeypatch, case, name, guide):
    """Every guide of `GuidedEdges`; with -rP the rows are shown."""
    monkeypatch.setattr(jd, "GuidedEdges", partial(jd.GuidedEdges, guide))
    spp, deviation = CASES.get((case, name), (128, 0.04))
    row = compare(case, name, spp, keys=8, boundary="GuidedEdges")
    print(f"{case}, {name}, {guide}: {row}")
    passes(row, deviation)


@pytest.mark.slow
@pytest.mark.parametrize(
    "broken",
    [None, jd.KernelDensity(both_sides=False, concave_edges=True, visibility_ray=False)],
    ids=["no boundary term", "Eq. 18 alone"],
)
def test_broken_on_purpose_fails(monkeypatch, broken):
    monkeypatch.setattr(jd, "KernelDensity", lambda: broken)
    row = compare("shadow_goathead", "translate_x", 128, keys=8)
    assert abs(row["projection"] - 1) > check.PROJECTION_TOLERANCE + 3 * row["projection_error"]


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["KernelDensity", "LineSampling"])
@pytest.mark.parametrize(("case", "name"), CASES)
def test_as_committed(case, name, boundary):
    assert compare(case, name, spp=1024, keys=8, boundary=boundary)["passed"]
