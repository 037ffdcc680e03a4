"""What derivatives do not cover. Terms and integrators have lists of it, which raise and make the docs' tables."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from jaxdr.moving import Moving
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
