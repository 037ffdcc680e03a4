"""All cases by name, and their references, which are kept beside this file."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import numpy as np

from tests.stability import deep, emitters, reflections, shadows, soups
from tests.stability.case import Case
from tests.stability.measure import Reference

THEMES: tuple[Callable[[], list[Case]], ...] = (
    shadows.cases,
    soups.cases,
    emitters.cases,
    emitters.skies,
    reflections.cases,
    deep.cases,
)
REFERENCES = Path(__file__).parent / "references"


@cache
def catalogue() -> dict[str, Case]:
    """Every case by its name."""
    made = [case for theme in THEMES for case in theme()]
    found = {case.name: case for case in made}
    assert len(found) == len(made), "two cases have the same name"
    return found


def structure(case: Case) -> tuple:
    """What compiled programs depend on."""
    shapes = jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), (case.scene, case.velocities()))
    return jax.tree.structure(shapes), tuple(jax.tree.leaves(shapes)), case.max_depth, case.spp


def stored(case: Case) -> Reference | None:
    """The kept reference, or None where it is not there or of another scene."""
    path = REFERENCES / f"{case.name}.npz"
    if not path.exists():
        return None
    with np.load(path) as kept:
        return Reference(kept["image"], kept["error"]) if str(kept["digest"]) == case.digest() else None


def store(case: Case, found: Reference) -> None:
    """Keep a reference."""
    REFERENCES.mkdir(exist_ok=True)
    image, error = (part.astype(np.float32) for part in found)
    np.savez_compressed(REFERENCES / f"{case.name}.npz", image=image, error=error, digest=case.digest())
