"""BSDFs, one model a file. Adding one: a file with a `BSDF` subclass, and its name here."""

from jaxdr.scene.bsdf.base import BSDF as BSDF
from jaxdr.scene.bsdf.base import TwoSided as TwoSided
from jaxdr.scene.bsdf.base import turn_with_reflection as turn_with_reflection
from jaxdr.scene.bsdf.diffuse import Diffuse as Diffuse
