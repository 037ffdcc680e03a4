"""Exact irradiance under a polygonal light partly hidden by convex blockers, and its exact derivatives.

What a blocker hides is the light clipped against the pyramid from the point over the blocker's outline, and each
polygon has Lambert's closed form. When a vertex moves, the visible arcs of the outlines of blocker and light sweep area
on the sphere of directions; their cosine-weighted sweep is the derivative. Nothing here comes from jaxdr: numpy,
float64, no sampling, no finite differences.
"""

from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull

NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)


def irradiance(point, normal, light, blockers=()):
    """Irradiance at a point under a one-sided light of radiance 1.

    `light` [L, 3]: planar, counter-clockwise seen from the side that emits. `blockers`: outlines [B, 3] of opaque
    things between the point and the light that look convex and disjoint from the point (they may touch: several convex
    pieces make any shape); either orientation, not necessarily planar.
    """
    light, normal = np.asarray(light, float) - point, np.asarray(normal, float)
    if _facing(light) @ light[0] >= 0:
        return 0.0  # the point is behind the light
    light = _clip(light, normal)
    total = _lambert(light, normal)
    for blocker in blockers:
        hidden = light
        for inward in _pyramid(np.asarray(blocker, float) - point):
            hidden = _clip(hidden, inward)
        total -= _lambert(hidden, normal)
    return total


def irradiance_derivatives(point, normal, light, blockers):
    """Derivatives of `irradiance`: vertices of each blocker (list), of the light, and the point (normal fixed)."""
    light, normal = np.asarray(light, float) - point, np.asarray(normal, float)
    blockers = [np.asarray(blocker, float) - point for blocker in blockers]
    if _facing(light) @ light[0] >= 0:
        return [np.zeros_like(blocker) for blocker in blockers], np.zeros_like(light), np.zeros(3)
    pyramids = [_pyramid(blocker) for blocker in blockers]
    outline = np.cross(light, np.roll(light, -1, axis=0))

    def lit(direction):
        return direction @ normal > 0 and direction @ _facing(light) < 0 and _winding(light, direction) != 0

    def unhidden(direction):
        return direction @ normal > 0 and all(np.any(pyramid @ direction < 0) for pyramid in pyramids)

    d_blockers = []
    for blocker, pyramid in zip(blockers, pyramids, strict=True):
        inwards = np.sign(np.cross(blocker[0], blocker[1]) @ pyramid[0])  # a growing blocker takes light away
        d_blockers.append(inwards * _sweep(blocker, normal, lit, [*outline, normal]))
    d_light = _sweep(light, normal, unhidden, [*np.concatenate([*pyramids, [normal]])])
    return d_blockers, d_light, -(sum(d.sum(0) for d in d_blockers) + d_light.sum(0))


def silhouette(point, vertices):
    """Indices of the vertices of a convex body that form its outline seen from the point, in order around it."""
    rays = np.asarray(vertices, float) - point
    axis = rays.mean(0)
    across = np.linalg.svd(axis[None])[2][1:]
    return ConvexHull((rays @ across.T) / (rays @ axis)[:, None]).vertices


def _facing(light):
    """Normal of the side that emits (not unit)."""
    return np.sum(np.cross(light, np.roll(light, -1, axis=0)), axis=0)


def _pyramid(outline):
    """Inward normals of the planes through the origin and each edge of a convex outline."""
    planes = np.cross(outline, np.roll(outline, -1, axis=0))
    return planes * np.sign(planes[0] @ outline.mean(0))


def _clip(polygon, plane):
    """Sutherland-Hodgman: the part of a polygon where `plane · x >= 0`."""
    out = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        da, db = a @ plane, b @ plane
        if da >= 0:
            out.append(a)
        if (da >= 0) != (db >= 0):
            out.append(a + da / (da - db) * (b - a))
    return np.array(out).reshape(-1, 3)


def _lambert(polygon, normal):
    """Lambert's contour formula: -1/2 Σ angle(r_i, r_{i+1}) n · unit(r_i × r_{i+1})."""
    total = 0.0
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        cross = np.cross(a, b)
        length = np.linalg.norm(cross)
        if length > 0:
            total -= 0.5 * np.arctan2(length, a @ b) * (cross @ normal) / length
    return total


def _winding(light, direction):
    """How often the outline winds around the direction (0: the ray misses the light)."""
    frame = np.linalg.svd(direction[None])[2][1:]
    x, y = frame @ light.T
    angle = np.arctan2(y, x)
    turn = (np.roll(angle, -1) - angle + np.pi) % (2 * np.pi) - np.pi
    return round(turn.sum() / (2 * np.pi))


def _sweep(outline, normal, visible, planes):
    """Cosine-weighted solid angle swept per displacement of each vertex, by the visible part of every edge.

    An edge from a to b seen from the origin: r(s) = a + s (b - a); moving r(s) by δ moves the arc by m·δ/|r| with
    m = unit(a × b), and ds covers |a × b|/|r|² of arc, so the sweep is  (a × b)·δ ∫ n·r(s)/|r(s)|⁴ ds.
    """
    out = np.zeros_like(outline)
    for i, (a, b) in enumerate(zip(outline, np.roll(outline, -1, axis=0), strict=True)):
        with np.errstate(divide="ignore", invalid="ignore"):
            breaks = np.array([-(m @ a) / (m @ (b - a)) for m in planes])
        breaks = np.unique([0.0, 1.0, *breaks[(breaks > 0) & (breaks < 1)]])
        for s0, s1 in pairwise(breaks):
            if not visible(a + 0.5 * (s0 + s1) * (b - a)):
                continue
            s = s0 + (s1 - s0) * (NODES + 1) / 2
            r = a + s[:, None] * (b - a)
            weight = WEIGHTS * (s1 - s0) / 2 * (r @ normal) / np.sum(r * r, axis=1) ** 2
            out[i] += np.cross(a, b) * np.sum(weight * (1 - s))
            out[(i + 1) % len(outline)] += np.cross(a, b) * np.sum(weight * s)
    return out
