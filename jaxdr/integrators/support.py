"""The table of refusals in the documentation (docs/limits.md): who refuses what, and what to take instead.

`python -m jaxdr.integrators.support` prints it.
"""

from jaxdr.boundary import ESTIMATORS
from jaxdr.boundary.film.hard_shadows import HardShadows
from jaxdr.boundary.shared.refusals import Refusal
from jaxdr.boundary.shared.texture_jumps import MOVED_MAPS
from jaxdr.boundary.warped_area.warped_camera import WarpedCamera
from jaxdr.integrators import INTEGRATORS

HEAD = "| who | refuses | take |\n| --- | --- | --- |\n"


def refusals() -> dict[str, tuple[Refusal, ...]]:
    """The refusals of every integrator, term and estimator, by its name."""
    found = {"all with boundary terms": (MOVED_MAPS,)}
    found |= {kind.__name__: kind.refusals for kind in INTEGRATORS.values()}
    found |= {"shadows of lights without area": HardShadows.refusals, '`primary="warp"`': WarpedCamera.refusals}
    return found | {name: getattr(kind, "refusals", ()) for name, kind in ESTIMATORS.items()}


def table() -> str:
    """The table in Markdown."""
    rows = [f"| {who} | {row.what} | {row.remedy} |" for who, several in refusals().items() for row in several]
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    print(table(), end="")
