"""Every public model that has parameters, and how it is built: a model that needs arguments has a row here."""

import inspect
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

import jaxdr as jd
from jaxdr.scene.bsdf.fresnel import ETA
from jaxdr.scene.ranges import FINITE, Parametric, Range, range_of


def _picture(height=3, width=4, low=0.2, high=0.9) -> np.ndarray:
    """A smooth image [H, W, 3] whose colours differ."""
    x, y = np.meshgrid(np.arange(width) / width, np.arange(height) / height)
    waves = np.stack([np.sin(2 * np.pi * (x + k / 3)) * np.sin(np.pi * (y + 0.2)) for k in range(3)], -1)
    return low + (high - low) * (0.5 + 0.5 * waves)


ABOVE = (0.6, -0.5, 2.4)
DOWN = (-0.6, 0.5, -2.2)
POSE = jd.look_at(ABOVE, (0, 0, 0.2), (0.3, 0.8, 0.1))
EYE = jd.look_at((0.0, -2.6, 1.7), (0.0, 0.0, 0.2), (0, 0, 1))
FILM = jd.Film(4, 4, jd.Box())

# Arguments without which a model can't be built, and those that bring in all of its lobes.
ARGUMENTS: dict[str, Callable[[], dict[str, Any]]] = {
    "AreaEmitter": lambda: {"radiance": (2.0, 1.5, 1.0)},
    "Bitmap": lambda: {"pixels": _picture(), "to_uv": np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.05]])},
    "Blend": lambda: {"weight": 0.4, "first": jd.Diffuse(0.6), "second": jd.RoughConductor(0.4)},
    "BumpMap": lambda: {"height": jd.Bitmap(_picture()[..., 0]), "bsdf": jd.Diffuse(0.6), "scale": 0.1},
    "Checkerboard": lambda: {"to_uv": np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.05]])},
    "Conductor": lambda: {"eta": (1.1, 1.3, 1.5), "k": (3.9, 2.4, 1.6), "specular_reflectance": 0.8},
    "DirectionalLight": lambda: {"direction": DOWN},
    "EnvironmentMap": lambda: {"radiance": _picture(5, 8), "to_world": POSE},
    "FaceColors": lambda: {"colors": _picture(1, 2)[0]},
    "Mask": lambda: {"opacity": 0.7, "bsdf": jd.Diffuse(0.6)},
    "NormalMap": lambda: {"normal": (0.55, 0.45, 0.9), "bsdf": jd.Diffuse(0.6)},
    "Orthographic": lambda: {"to_world": EYE, "film": FILM},
    "Perspective": lambda: {"to_world": EYE, "fov": 40.0, "film": FILM},
    "Phong": lambda: {"exponent": 8.0},
    "PointLight": lambda: {"position": ABOVE, "intensity": (3.0, 2.5, 2.0)},
    "Principled": lambda: {
        "base_color": (0.7, 0.5, 0.3),
        "metallic": 0.3,
        **dict.fromkeys(("spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss", "flatness"), 0.4),
        "anisotropic": 0.4,
        "spec_trans": 0.4,
    },
    "Product": lambda: {"first": jd.Bitmap(_picture()), "second": jd.Bitmap(_picture(4, 3))},
    "Projector": lambda: {"irradiance": _picture(), "to_world": POSE, "fov": 50.0},
    "RoughConductor": lambda: {"eta": (1.1, 1.3, 1.5), "k": (3.9, 2.4, 1.6), "alpha": 0.4, "alpha_v": 0.5},
    "RoughDielectric": lambda: {"alpha": 0.4, "alpha_v": 0.5},
    "RoughPlastic": lambda: {"alpha": 0.4},
    "SpotLight": lambda: {"position": ABOVE, "direction": DOWN, "intensity": 3.0, "cutoff_angle": 30.0},
    "TexturedSpotLight": lambda: {
        "position": ABOVE,
        "direction": DOWN,
        "texture": _picture(),
        "up": (0.3, 0.8, 0.1),
        "intensity": 3.0,
        "cutoff_angle": 30.0,
    },
    "ThinLens": lambda: {"to_world": EYE, "fov": 40.0, "film": FILM, "aperture_radius": 0.05, "focus_distance": 3.0},
    "VertexColors": lambda: {"colors": _picture(1, 4)[0]},
}


# Fields that are places or directions. They have no border. Every other field without a range has one at zero.
PLACES = ("position", "direction", "up", "to_world", "to_uv", "principal_point")


def _public_models() -> list[str]:
    kinds = {name: kind for name, kind in vars(jd).items() if inspect.isclass(kind) and issubclass(kind, Parametric)}
    return sorted(name for name, kind in kinds.items() if not inspect.isabstract(kind))


MODELS = _public_models()


def made(name: str, **changed) -> Any:
    """The model of this name, with some arguments changed."""
    return getattr(jd, name)(**(ARGUMENTS.get(name, dict)() | changed))


def of_kind(kind: type) -> list[str]:
    """Names of the public models of a kind."""
    return [name for name in MODELS if issubclass(getattr(jd, name), kind)]


class Border(NamedTuple):
    """An end of the values of one field: `inwards` is 1 at a lower end, and -1 at an upper one.

    `span` is the size of the range, or of the field's usual value where the range has no other end.
    """

    model: str
    field: str
    end: float
    inwards: int
    span: float

    @property
    def name(self) -> str:
        return f"{self.model}.{self.field} = {self.end:g}"


def borders(name: str, within: Range = FINITE) -> list[Border]:
    """The borders of a model's own fields; those of a field without a range are those of the field that it is in."""
    model, found = made(name), []
    for field in model.__dataclass_fields__:
        value = getattr(model, field)
        if not eqx.is_inexact_array(value) or field in PLACES:
            continue
        declared = range_of(model, field)
        declared = within if declared == FINITE else declared
        if declared.open:
            continue  # the ends themselves are no values
        low, high = (0.0 if declared.low == -math.inf else declared.low), declared.high
        span = high - low if math.isfinite(high - low) else float(np.abs(np.asarray(value)).mean())
        found.append(Border(name, field, low, 1, low if (low, high) == ETA else span))
        if math.isfinite(high):
            found.append(Border(name, field, high, -1, span))
    return found
