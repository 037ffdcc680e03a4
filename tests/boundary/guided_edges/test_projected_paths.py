"""Projected paths: lines past edges that begin in what the film shows and end on the light, however small it is."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.boundary.guided_edges.boundary_segments import EmitterSampling
from jaxdr.boundary.guided_edges.edge_lunes import edge_lunes
from jaxdr.boundary.guided_edges.guide_target import StrategyPlan, segment_target
from jaxdr.boundary.guided_edges.projected_paths import project_paths
from jaxdr.scene.packed import pack
from jaxdr.transport.path_settings import PathSettings
from tests.gradients.floor_patch import scene
from tests.gradients.floor_point import LIGHT

SETTINGS = PathSettings(2, True, "auto")
MOVING = (True, False, False)  # of blocker, floor, light


@jax.jit
def projected(of, u):
    """(whether lines are valid, the target at their numbers and at some uniform ones) of a scene."""
    packed = pack(of)
    lunes = edge_lunes(packed, MOVING)
    lines = project_paths(packed, lunes, 4096, jax.random.key(0), "auto")
    points = jnp.concatenate([EmitterSampling.numbers(packed, lunes, *lines), u])
    plan = StrategyPlan(EmitterSampling, True, False)
    target = segment_target(packed, lunes, jnp.asarray(MOVING), None, plan, jax.random.key(1), SETTINGS)
    return lines[1].valid, target(points)


def torus(height):
    """1,536 edges."""
    matrix = np.eye(4)
    matrix[2, 3] = height
    return jd.shapes.transformed(jd.shapes.torus(0.3, 0.1, 32, 16), matrix)


def test_lines_count():
    """Before a light of a hundredth of the side nearly all projected lines carry light to the film."""
    middle = LIGHT.mean(0)
    of = scene(torus(0.6), middle + 0.01 * (LIGHT - middle))
    valid, target = jax.device_get(projected(of, jax.random.uniform(jax.random.key(2), (4096, 3))))
    assert valid.mean() > 0.9
    assert (target[:4096] > 0)[valid].mean() > 0.9
    assert (target[4096:] > 0).mean() < 0.05


def test_nothing_hidden():
    """Without a shadow no line is valid."""
    assert not jax.device_get(projected(scene(torus(50.0)), jnp.zeros((4096, 3)))[0]).any()
