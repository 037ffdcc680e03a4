"""Properties of scenes that make estimators fail by nature, not by noise. Estimators say so in `known_failure`."""

from typing import Any, NamedTuple

from jaxdr.scene.emitter_clusters import FEW_FACES
from jaxdr.scene.scene import Scene

# With so many faces in one mesh, or more, kernel density is clearly too large (experiments/tessellation). Guided edges
# were measured at a million faces only (docs/stability.md).
FINE = 300_000


class Traits(NamedTuple):
    """Properties of a scene that make estimators fail. They depend on structure only, such as the sizes of arrays.

    - `fine`: name of the shape with the most faces, if it has `FINE` or more; else None.
    - `emitter_faces`: number of faces of area emitters.
    """

    fine: str | None
    emitter_faces: int

    @property
    def mesh_lamps(self) -> bool:
        """Whether the area emitters have more faces than one look at all of them is worth."""
        return self.emitter_faces > FEW_FACES


def traits(scene: Scene) -> Traits:
    """The `Traits` of a scene, traced or not."""
    faces = {name: shape.mesh.faces.shape[0] for name, shape in scene.shapes.items()}
    largest = max(faces, key=lambda name: faces[name])
    emitting = (faces[name] for name, shape in scene.shapes.items() if shape.emitter is not None)
    return Traits(largest if faces[largest] >= FINE else None, sum(emitting))


def known_failure(boundary: Any, found: Traits) -> str | None:
    """Why a boundary estimator is biased on such a scene, with any number of samples, and the remedy; None if not.

    An estimator that fails somewhere has a method `known_failure(traits)`. Estimators without it fail nowhere.
    """
    method = getattr(boundary, "known_failure", None)
    return None if method is None else method(found)


def too_fine(found: Traits) -> str | None:
    """The failure of estimators whose visibility rays pass an edge at a distance."""
    if found.fine is None:
        return None
    return (
        f"it is too large by 6 % or more on meshes of {FINE:,} faces or more, such as {found.fine}: silhouettes "
        "that are hidden by no more than rounding count as visible; take LineSampling"
    )
