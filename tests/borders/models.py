"""Every public model that has parameters, and how it is built: a model that needs arguments has a row here."""

import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np

import jaxdr as jd
from jaxdr.scene.ranges import Parametric


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
    "Conductor": lambda: {"eta": (0.2, 0.9, 1.5), "k": (3.9, 2.4, 1.6), "specular_reflectance": 0.8},
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
    "RoughConductor": lambda: {"eta": (0.2, 0.9, 1.5), "k": (3.9, 2.4, 1.6), "alpha": 0.4, "alpha_v": 0.5},
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


def _public_models() -> list[str]:
    kinds = {name: kind for name, kind in vars(jd).items() if inspect.isclass(kind) and issubclass(kind, Parametric)}
    return sorted(name for name, kind in kinds.items() if not kind.__abstractmethods__ and name != "Texture")


MODELS = _public_models()


def made(name: str, **changed) -> eqx.Module:
    """The model of this name, with some arguments changed."""
    return getattr(jd, name)(**(ARGUMENTS.get(name, dict)() | changed))
