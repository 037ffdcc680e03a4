"""What a scene has, and what its compiled program therefore contains. No ray is traced for that."""

from collections import Counter
from typing import NamedTuple

from jaxdr.boundary.shared.traits import Traits, traits
from jaxdr.moving import Moving
from jaxdr.scene.scene import Scene, textures_of, unwrap


class StaticLook(NamedTuple):
    """Models with the number of their uses, names of textured parameters, numbers of faces and edges.

    - `traits`: properties of the scene for which some estimators are known to fail.
    - `film_edges`: number of edges that move relative to the camera. Only these are sampled in the image.
    - `still_edges`: number of the other edges. Behind the first hit they carry derivatives only for path segments that
      end on something that moves.
    """

    lobes: dict[str, int]
    lights: dict[str, int]
    textures: tuple[str, ...]
    faces: int
    edges: int
    film_edges: int
    still_edges: int
    traits: Traits
    moving: Moving

    def lines(self) -> list[str]:
        """Lines that say what is in the program, and which edges carry derivatives."""
        moving = self.moving
        found = [
            f"lobes: {_counted(self.lobes)}; no other model is in the program",
            f"lights: {_counted(self.lights) or 'none'}",
            f"textures: {', '.join(self.textures) or 'none'}",
        ]
        if not moving.any:
            found.append(f"edges: nothing moves, so none of {self.edges:,} carries a derivative: no boundary terms")
            return found
        shapes = f"{sum(moving.shapes)} of {len(moving.shapes)} shapes"
        what = "the camera" if moving.camera else shapes
        if any(moving.lights) or moving.environment:
            what += " and lights"
        found.append(f"edges: {what} move: {self.film_edges:,} of {self.edges:,} edges can move in the image")
        if self.still_edges and any(moving.seen):
            found.append(
                f"edges behind the first hit: the {self.still_edges:,} edges of what stands still count only for path "
                "segments that end on something that moves"
            )
        return found


def static_look(scene: Scene, moving: Moving) -> StaticLook:
    """What a scene has, if the derivative is by parameters that move `moving`."""
    emitters = [shape for shape in scene.shapes.values() if shape.emitter is not None]
    lights = Counter(type(light).__name__ for light in scene.lights.values())
    if emitters:
        lights["AreaEmitter"] = len(emitters)
    if scene.environment is not None:
        lights[type(scene.environment).__name__] = 1
    edges = [shape.mesh.edges.vertices.shape[0] for shape in scene.shapes.values()]
    film = sum(count for count, moves in zip(edges, moving.seen, strict=True) if moves)
    return StaticLook(
        lobes=dict(Counter(type(unwrap(shape.bsdf)).__name__ for shape in scene.shapes.values())),
        lights=dict(lights),
        textures=tuple(f"{name}.{field}" for name, shape in scene.shapes.items() for field, _ in textures_of(shape)),
        faces=sum(shape.mesh.faces.shape[0] for shape in scene.shapes.values()),
        edges=sum(edges),
        film_edges=film,
        still_edges=sum(edges) - film,
        traits=traits(scene),
        moving=moving,
    )


def _counted(models: dict[str, int]) -> str:
    return ", ".join(name if count == 1 else f"{name} ({count})" for name, count in models.items())
