"""BSDFs, one file for each model. A new model is a file with a subclass of `BSDF`, and its name here."""

from jaxdr.scene.bsdf.base import BSDF as BSDF
from jaxdr.scene.bsdf.base import Adapter as Adapter
from jaxdr.scene.bsdf.base import DeltaSample as DeltaSample
from jaxdr.scene.bsdf.base import TwoSided as TwoSided
from jaxdr.scene.bsdf.blend import Blend as Blend
from jaxdr.scene.bsdf.bump_map import BumpMap as BumpMap
from jaxdr.scene.bsdf.conductor import Conductor as Conductor
from jaxdr.scene.bsdf.dielectric import Dielectric as Dielectric
from jaxdr.scene.bsdf.diffuse import Diffuse as Diffuse
from jaxdr.scene.bsdf.mask import Mask as Mask
from jaxdr.scene.bsdf.normal_map import NormalMap as NormalMap
from jaxdr.scene.bsdf.phong import Phong as Phong
from jaxdr.scene.bsdf.plastic import Plastic as Plastic
from jaxdr.scene.bsdf.principled import Principled as Principled
from jaxdr.scene.bsdf.rough_conductor import RoughConductor as RoughConductor
from jaxdr.scene.bsdf.rough_dielectric import RoughDielectric as RoughDielectric
from jaxdr.scene.bsdf.rough_plastic import RoughPlastic as RoughPlastic
from jaxdr.scene.bsdf.thin_dielectric import ThinDielectric as ThinDielectric
