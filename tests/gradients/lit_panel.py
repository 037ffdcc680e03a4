"""The light of `floor_point` one bounce later: a panel in its place, lit by a far lamp."""

import dataclasses

import numpy as np

import jaxdr as jd
from tests.gradients.floor_point import LIGHT, RADIANCE

DISTANCE, SIZE = 1000.0, 50.0
TOWARDS_LAMP = np.array([0.0, 1.0, -0.15]) / np.hypot(1.0, 0.15)
PANEL_REFLECTANCE = 0.8


def lit_panel(under: jd.Scene) -> jd.Scene:
    """The scene with a reflecting panel for its "light": its radiance is `RADIANCE` up to 0.1 %.

    The lamp stands low to one side: nothing shades the panel, and it does not reach the upper side of the floor.
    """
    centre = DISTANCE * TOWARDS_LAMP
    left = np.array([1.0, 0.0, 0.0])
    up = np.cross(TOWARDS_LAMP, left)
    corners = centre + 0.5 * SIZE * np.array([-left - up, left - up, left + up, -left + up])
    lamp = jd.Mesh(corners[::-1], [[0, 1, 2], [0, 2, 3]])
    towards = centre - LIGHT.mean(0)
    squared = towards @ towards
    per_radiance = SIZE**2 * (-towards[2] / np.sqrt(squared)) * (towards @ TOWARDS_LAMP / np.sqrt(squared)) / squared
    emitted = RADIANCE / (PANEL_REFLECTANCE / np.pi * per_radiance)
    shapes = dict(under.shapes)
    shapes["light"] = jd.Shape(shapes["light"].mesh, jd.Diffuse(PANEL_REFLECTANCE))
    shapes["lamp"] = jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(float(emitted)))
    return dataclasses.replace(under, shapes=shapes)
