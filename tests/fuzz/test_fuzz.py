"""Damaged inputs of every kind: each is read, or refused by one error with the name of the file.

`python -m tests.fuzz.run` damages many more, in processes with limits.
"""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.examine import examine, example
from tests.fuzz.kind import Kind
from tests.fuzz.kinds import KINDS

EXAMPLES = 50  # of each kind


@pytest.fixture(scope="module", params=[*KINDS])
def kind(request, tmp_path_factory):
    place = tmp_path_factory.mktemp("fuzz")
    return KINDS[request.param], example(KINDS[request.param], place / "valid"), place / "input"


def test_valid_inputs_are_read(kind):
    of, valid, _ = kind
    of.read(valid)


@pytest.mark.parametrize(
    ("read", "fault"),
    [
        (lambda folder: {}["x"], "KeyError"),
        (lambda folder: float("x"), "the message does not name the file"),
        (lambda folder: [bytes(1 << 30), bytearray(b"x") * (1100 << 20)] and None, "MB"),
    ],
)
def test_faults_are_found(tmp_path, read, fault):
    kind = Kind("trial", lambda folder: (folder / "a.txt").write_text("1"), read, text=True)
    outcome = examine(kind, example(kind, tmp_path / "valid"), tmp_path / "input", 0)
    assert fault in outcome.fault


@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[*HealthCheck],
)
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_inputs(kind, seed):
    of, valid, place = kind
    assert not examine(of, valid, place, seed).fault
