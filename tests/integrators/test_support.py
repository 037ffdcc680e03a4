"""What is refused: one table, that of the code and of the documentation."""

from pathlib import Path

from jaxdr.boundary import ESTIMATORS
from jaxdr.boundary.shared.refusals import Refusal
from jaxdr.integrators import INTEGRATORS
from jaxdr.integrators.support import refusals, table

LIMITS = Path(__file__).parents[2] / "docs" / "limits.md"


def test_the_documentation_has_the_table_of_the_code():
    assert table() in LIMITS.read_text(encoding="utf-8")


def test_all_integrators_and_estimators_are_in_it():
    names = set(refusals())
    assert {kind.__name__ for kind in INTEGRATORS.values()} <= names
    assert set(ESTIMATORS) <= names
    assert all(isinstance(row, Refusal) for rows in refusals().values() for row in rows)
