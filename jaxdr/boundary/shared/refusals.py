"""What derivatives do not cover. Terms and integrators have lists of it, which raise and make the docs' tables."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from jaxdr.moving import Moving
from jaxdr.scene.bsdf.base import spreads_through
from jaxdr.scene.camera import Perspective
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene
from jaxdr.transport.path_settings import PathSettings

INTERIOR = "or boundary=None for the interior term alone"


class Asked(NamedTuple):
    """A derivative that is asked for. Terms know `packed` and `settings` only, integrators everything.

    `packed` is None until the scene is packed.
    """

    packed: PackedScene | None
    settings: PathSettings
    scene: Scene | None = None
    moving: Moving | None = None
    primary: str = "fixed_ray"


class Refusal(NamedTuple):
    """One thing that is not covered: its name, a remedy, and a function that returns the error message or None."""

    what: str
    remedy: str
    message: Callable[[Any], str | None]


def refuse(refusals: Iterable[Refusal], asked: Any) -> None:
    """Raises ValueError with the message of the first refusal that has one."""
    for refusal in refusals:
        message = refusal.message(asked)
        if message is not None:
            raise ValueError(message)


def edge_refusal(name: str, what: str, covered: str, found: Callable[[PackedScene], Any]) -> Refusal:
    """A refusal of the estimator `name`, which draws edges, where `found` says so; {} in `covered` is the camera."""

    def message(asked: Asked) -> str | None:
        packed = asked.packed
        if packed is None or not found(packed):
            return None
        covers = covered.format(type(packed.camera).__name__)
        return f"render: {name} covers {covers}; take KernelDensity or LineSampling, {INTERIOR}"

    return Refusal(what, "`KernelDensity`, `LineSampling`", message)


def edge_refusals(name: str) -> tuple[Refusal, ...]:
    """What no estimator that draws edges covers."""
    return (
        edge_refusal(
            name,
            "mirrors and smooth glass",
            "no visibility changes over mirrors and smooth glass",
            lambda packed: packed.has_delta_lobes,
        ),
        edge_refusal(
            name,
            "interpolated normals",
            "no horizons of surfaces with interpolated normals",
            lambda packed: packed.normals is not None,
        ),
        edge_refusal(
            name,
            "rough glass",
            "nothing that is seen through rough glass",
            lambda packed: any(spreads_through(group.bsdf) for group in packed.bsdfs),
        ),
    )


def perspective_refusal(name: str) -> Refusal:
    """What estimators do not cover that join points of the scene with a pinhole."""
    return edge_refusal(
        name,
        "cameras other than `Perspective`",
        "no {} camera, only Perspective",
        lambda packed: not isinstance(packed.camera, Perspective),
    )
