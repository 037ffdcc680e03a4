"""Lights without area, one file for each. A new light is a file with a subclass of `DeltaLight`, and its name here."""

from jaxdr.scene.lights.base import DeltaLight as DeltaLight
from jaxdr.scene.lights.directional import DirectionalLight as DirectionalLight
from jaxdr.scene.lights.point import PointLight as PointLight
from jaxdr.scene.lights.projector import Projector as Projector
from jaxdr.scene.lights.spot import SpotLight as SpotLight
from jaxdr.scene.lights.spot import TexturedSpotLight as TexturedSpotLight
