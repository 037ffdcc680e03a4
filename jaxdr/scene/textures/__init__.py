"""Textures, one file for each model. A new texture is a file with a subclass of `Texture`, and its name here."""

from jaxdr.scene.textures.base import Texture as Texture
from jaxdr.scene.textures.base import TexturePoint as TexturePoint
from jaxdr.scene.textures.base import textures_in as textures_in
from jaxdr.scene.textures.bitmap import Bitmap as Bitmap
from jaxdr.scene.textures.checkerboard import Checkerboard as Checkerboard
from jaxdr.scene.textures.heights import Heights as Heights
from jaxdr.scene.textures.mesh_colors import FaceColors as FaceColors
from jaxdr.scene.textures.mesh_colors import VertexColors as VertexColors
from jaxdr.scene.textures.product import Product as Product
