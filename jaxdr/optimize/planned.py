"""The integrator of a run, where the config leaves it to `jaxdr.plan`: measured once, then kept in the run's folder."""

import json
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import PRNGKeyArray

from jaxdr.boundary.named import estimator_name
from jaxdr.integrators.choice import choose
from jaxdr.optimize.config import AUTO, PLAN, Integrator
from jaxdr.optimize.output import RunFolder
from jaxdr.optimize.processes import of_writer
from jaxdr.plan.plan import MEASURED, plan
from jaxdr.plan.report import Plan
from jaxdr.scene.scene import Scene


def planned(
    options: Integrator,
    scene: Scene,
    params: Sequence[str],
    spp: int,
    key: PRNGKeyArray,
    folder: RunFolder,
) -> Plan | None:
    """The plan for derivatives of `spp` samples by `params`, or None where the config names the integrator.

    It is printed to stderr and written to `plan.json`; a run that is resumed takes the one that is there, with nothing
    measured again. Raises ValueError as `plan` does, and for a file that is damaged or names an estimator of others
    that the config does not name.
    """
    if not options.planned:
        return None
    if (kept := folder.load_plan(_named(options))) is not None:
        return kept

    def measured() -> dict[str, np.ndarray]:
        print("jaxdr: plan: a pilot measures which integrator to take; see [integrator] to choose it", file=sys.stderr)
        found = plan(
            scene,
            params,
            key=key,
            max_depth=None if options.max_depth == PLAN else int(options.max_depth),
            boundary=_boundary(options, scene),
            spp=spp,
        )
        for line in found.lines:
            print(f"jaxdr: plan: {line}", file=sys.stderr)
        folder.save_plan(found)
        return {"plan": np.asarray(json.dumps(found.to_dict()))}

    # Times decide, and they differ between processes.
    return Plan.from_dict(json.loads(str(of_writer(measured)["plan"])))


def _boundary(options: Integrator, scene: Scene) -> Any:
    """The estimator that the plan keeps, or `MEASURED`."""
    if options.boundary == PLAN:
        return MEASURED
    return choose(scene).estimator if options.boundary == AUTO else options.estimator()


def _named(options: Integrator) -> list[str]:
    """The name of the estimator that the config names, where it is not left to rules or to the plan."""
    estimator = None if options.boundary in (AUTO, PLAN) else options.estimator()
    return [] if estimator is None else [estimator_name(type(estimator))]
