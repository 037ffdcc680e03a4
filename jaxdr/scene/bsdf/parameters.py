"""Parameters of BSDFs and area emitters: what a user may give for them. Ranges are declared at the fields (`ranges`).

Each parameter may be a texture. Before a BSDF is evaluated, the values at
the points take the place of the texture. `Color` and `Number` are types of fields, which models compute with. `Value`
is the type of what the user gives for such a field,
and `Index` of what stands for an index of refraction.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.arrays import as_array, as_numbers, on_host
from jaxdr.scene.bsdf.fresnel import ETA as ETA
from jaxdr.scene.bsdf.materials import DIELECTRICS, METALS
from jaxdr.scene.bsdf.microfacet import DISTRIBUTIONS, SMOOTHEST
from jaxdr.scene.color import as_rgb
from jaxdr.scene.ranges import Range, check_range
from jaxdr.scene.textures import Texture

if TYPE_CHECKING:
    Color = Float[Array, "*n 3"]
    Number = Float[Array, "*n"]
    Value = ArrayLike | Texture
    Index = ArrayLike | str
else:
    Color = Float[Array, "*n 3"] | Texture
    Number = Float[Array, "*n"] | Texture
    Value = Index = object  # NumPy's ArrayLike is written for static checkers

ALPHA = SMOOTHEST, 1.0  # range of the alpha of a microfacet distribution


def number(value, name: str, low: float = -np.inf, high: float = np.inf) -> Number:
    """A number in [low, high], or a texture of numbers. Raises ValueError, with the parameter's name, otherwise.

    For a field with a declared range leave out the ends: the model checks it (`ranges.Parametric`).
    """
    if isinstance(value, Texture):
        return _texture(value, name, 1, low, high)
    array = as_numbers(value, name)
    if array.shape != ():
        raise ValueError(f"{name} must be a number, got shape {array.shape}")
    if (low, high) != (-np.inf, np.inf):
        check_range(array, name, Range(low, high))
    return array


def rgb(value, name: str, low: float = 0.0, high: float = 1.0) -> Color:
    """RGB from one number or three in [low, high], or a texture. Raises ValueError, with its name, otherwise."""
    array = color(value, name)
    check_range(array, name, Range(low, high))
    return array


def color(value, name: str) -> Color:
    """`rgb` for a field with a declared range, which the model checks (`ranges.Parametric`)."""
    return _texture(value, name, 3) if isinstance(value, Texture) else as_rgb(value, name)


def _texture(texture: Texture, name: str, channels: int, low: float = -np.inf, high: float = np.inf) -> Any:
    fitted = texture.fitted(channels, name)
    check_range(fitted, name, Range(low, high))
    return fitted


def optional_number(value, name: str) -> Number | None:
    """A number or a texture; None where it is not given."""
    return None if value is None else number(value, name)


def distribution_name(name: str, model: str) -> str:
    """A known microfacet distribution."""
    if name not in DISTRIBUTIONS:
        raise ValueError(f"{model}: distribution must be {' or '.join(DISTRIBUTIONS)}, got {name!r}")
    return name


def relative_index(int_ior, ext_ior, model: str, low: float = ETA[0], high: float = ETA[1]) -> Float[Array, ""]:
    """Interior index of refraction over the exterior one; each is a number or the name of a dielectric."""
    inside, outside = (_index(v, f"{model}: {n}") for v, n in ((int_ior, "int_ior"), (ext_ior, "ext_ior")))
    return number(on_host(inside) / on_host(outside), f"{model}: int_ior / ext_ior", low, high)


def _index(value, name) -> Float[Array, ""]:
    if isinstance(value, Texture):
        raise ValueError(f"{name} must be a number or a name, not a texture")
    if isinstance(value, str):
        if value.lower() not in DIELECTRICS:
            raise ValueError(f"{name}: unknown material {value!r}; known: {', '.join(DIELECTRICS)}")
        value = DIELECTRICS[value.lower()]
    return number(value, name, 0.1, 100.0)


def complex_index(material, eta, k, model: str) -> tuple[Color, Color]:
    """(eta, k), RGB, as given or of a named metal; those of a perfect mirror if nothing is given."""
    if (eta is None) != (k is None):
        raise ValueError(f"{model}: give both eta and k, or neither")
    if eta is not None:
        if material is not None:
            raise ValueError(f"{model}: give either a material or eta and k, not both")
        return color(eta, f"{model}: eta"), color(k, f"{model}: k")
    if material is None:
        return as_array(np.zeros(3)), as_array(np.ones(3))
    if material not in METALS:
        raise ValueError(f"{model}: unknown material {material!r}; known: {', '.join(METALS)}")
    eta, k = METALS[material]
    return as_array(eta), as_array(k)
