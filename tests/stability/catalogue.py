"""All cases by name, and their references, which are kept beside this file."""

import dataclasses
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from tests.stability import deep, emitters, reflections, shadows, soups
from tests.stability.case import ESTIMATORS, Case, Expected
from tests.stability.measure import Reference, verdict

THEMES: tuple[Callable[[], list[Case]], ...] = (
    shadows.cases,
    soups.cases,
    emitters.cases,
    emitters.skies,
    reflections.cases,
    deep.cases,
)
RARE = Expected(
    "noisy", "it draws edges even if they are hidden, so few draws find the border of a small light's shadow"
)
FAINT = Expected("noisy", "it draws edges even if they are hidden, and few of the drawn edges contribute")
CROSSING = Expected(
    "noisy", "warps are noisy wherever light is seen, most where silhouettes of different velocities are close"
)
MEETS = Expected(
    "biased",
    "pixels along the line where lamp and floor touch are off by up to a third. A likely reason: emitter samples "
    'hardly find the light there, which the edge of the image needs. With sampling="mis" these pixels are noisy, as '
    "for the others",
)
# What is known of the newer estimators: by estimator, case and verdict. The others have it in their cases.
NEWER: dict[str, dict[str, Expected]] = {
    "QuadricSampling": dict.fromkeys(("tiny_light", "interpenetrating", "lamp_of_many_faces"), RARE)
    | dict.fromkeys(("self_shadow_reflected", "tessellation_1k", "tessellation_100k", "tessellation_1M"), FAINT)
    | {"moving_emitter_at_wall": emitters.TOUCHES, "mirror_low_roughness": reflections.LOBE},
    "MarkovChains": {"moving_emitter_at_wall": emitters.TOUCHES, "mirror_low_roughness": reflections.LOBE},
    "AllSilhouettes": {
        "moving_emitter_at_wall": emitters.TOUCHES,
        "mirror_low_roughness": reflections.LOBE,
        "tessellation_1M": deep.OFFSET,
    },
    "WalkOnCaps": dict.fromkeys(
        ("tiny_light", "lamp_of_many_faces", "glossy_smooth", "coplanar", "crossing_triangles", "sky_pixel"), CROSSING
    )
    | {"moving_emitter_at_wall": MEETS},
}
REFERENCES = Path(__file__).parent / "references"
RESULTS = Path(__file__).parents[2] / "experiments" / "stability" / "results"


@cache
def catalogue() -> dict[str, Case]:
    """Every case by its name."""
    made = [case for theme in THEMES for case in theme()]
    found = {case.name: case for case in made}
    assert len(found) == len(made), "two cases have the same name"
    for name, case in found.items():
        known = {estimator: rows[name] for estimator, rows in NEWER.items() if name in rows}
        refused = case.expected.get("RednerWAS")
        if refused is not None and refused.verdict == "refuses":  # `WalkOnCaps` has the same scope
            known["WalkOnCaps"] = refused
        found[name] = dataclasses.replace(case, expected=dict(case.expected) | known)
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


def measured(case: Case, folder: Path = RESULTS) -> dict[str, dict[str, Any]]:
    """Cells of the table by estimator, as `experiments.stability.run` has written them and judged by the case as it is.

    Those of another scene or of other settings are left out.
    """
    path = folder / f"{case.name}.json"
    if not path.exists():
        return {}
    return {
        name: cell | {"verdict": verdict(case, name, cell)}
        for name, cell in json.loads(path.read_text())["cells"].items()
        if name in ESTIMATORS and cell["fingerprint"] == case.fingerprint(name)
    }


def store(case: Case, found: Reference) -> None:
    """Keep a reference."""
    REFERENCES.mkdir(exist_ok=True)
    image, error = (part.astype(np.float32) for part in found)
    np.savez_compressed(REFERENCES / f"{case.name}.npz", image=image, error=error, digest=case.digest())
