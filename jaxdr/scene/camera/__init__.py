"""Cameras, one file for each. A new camera is a file with a subclass of `Camera`, and its name here."""

from jaxdr.scene.camera.base import Camera as Camera
from jaxdr.scene.camera.base import look_at as look_at
from jaxdr.scene.camera.orthographic import Orthographic as Orthographic
from jaxdr.scene.camera.perspective import Perspective as Perspective
from jaxdr.scene.camera.thin_lens import ThinLens as ThinLens
from jaxdr.scene.camera.view import ParallelView as ParallelView
from jaxdr.scene.camera.view import PinholeView as PinholeView
from jaxdr.scene.camera.view import View as View
