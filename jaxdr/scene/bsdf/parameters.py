"""Parameters of BSDFs and area emitters. Their shapes and ranges are checked when a model is made.

The range of traced values can't be checked. Each parameter may be a texture. Before a BSDF is evaluated, the values at
the points take the place of the texture. `Color` and `Number` are types of fields, which models compute with. `Value`
is the type of what the user gives for such a field.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.arrays import as_array, on_host
from jaxdr.scene.bsdf.materials import DIELECTRICS, METALS
from jaxdr.scene.bsdf.microfacet import DISTRIBUTIONS
from jaxdr.scene.color import as_rgb
from jaxdr.scene.textures import Texture

if TYPE_CHECKING:
    Color = Float[Array, "*n 3"]
    Number = Float[Array, "*n"]
    Value = ArrayLike | Texture
else:
    Color = Float[Array, "*n 3"] | Texture
    Number = Float[Array, "*n"] | Texture
    Value = object  # NumPy's ArrayLike is written for static checkers

SMOOTHEST = 1e-4  # least alpha: half-vectors in float32 are too coarse for less


def number(value, name: str, low: float, high: float) -> Number:
    """A number in [low, high], or a texture of numbers. Raises ValueError, with the parameter's name, otherwise."""
    if isinstance(value, Texture):
        return _texture(value, name, 1, low, high)
    array = as_array(value)
    if array.shape != ():
        raise ValueError(f"{name} must be a number, got shape {array.shape}")
    _check_range(array, name, low, high)
    return array


def rgb(value, name: str, low: float = 0.0, high: float = 1.0) -> Color:
    """RGB from one number or three in [low, high], or a texture. Raises ValueError, with its name, otherwise."""
    if isinstance(value, Texture):
        return _texture(value, name, 3, low, high)
    array = as_rgb(value, name)
    _check_range(array, name, low, high)
    return array


def _texture(texture: Texture, name: str, channels: int, low: float, high: float) -> Any:
    fitted = texture.fitted(channels, name)
    fitted.check_range(name, low, high)
    return fitted


def _check_range(array, name, low, high):
    if isinstance(array, Tracer):
        return
    values = np.asarray(array)
    if not np.all((values >= low) & (values <= high) & np.isfinite(values)):
        expected = f"in [{low:g}, {high:g}]" if np.isfinite(high) else f"at least {low:g}"
        raise ValueError(f"{name} must be {expected}, got {values.tolist()}")


def roughness(value, model: str) -> Number:
    """The alpha of a microfacet distribution."""
    return number(value, f"{model}: alpha", SMOOTHEST, 1.0)


def roughness_across(value, model: str) -> Number | None:
    """The alpha along the y axis; None where it is the same in all directions."""
    return None if value is None else number(value, f"{model}: alpha_v", SMOOTHEST, 1.0)


def distribution_name(name: str, model: str) -> str:
    """A known microfacet distribution."""
    if name not in DISTRIBUTIONS:
        raise ValueError(f"{model}: distribution must be {' or '.join(DISTRIBUTIONS)}, got {name!r}")
    return name


def relative_index(int_ior, ext_ior, model: str, low: float = 0.0, high: float = np.inf) -> Float[Array, ""]:
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
        return rgb(eta, f"{model}: eta", 0.0, np.inf), rgb(k, f"{model}: k", 0.0, np.inf)
    if material is None:
        return as_array(np.zeros(3)), as_array(np.ones(3))
    if material not in METALS:
        raise ValueError(f"{model}: unknown material {material!r}; known: {', '.join(METALS)}")
    eta, k = METALS[material]
    return as_array(eta), as_array(k)
