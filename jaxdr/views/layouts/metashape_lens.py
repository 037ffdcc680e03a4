"""Lenses of Metashape in COLMAP's terms.

Metashape's manual, appendix "Camera models", has for frame cameras, with x = X / Z, y = Y / Z, r² = x² + y²:

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + (p1 (r² + 2 x²) + 2 p2 x y) (1 + p3 r² + p4 r⁴)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + (p2 (r² + 2 y²) + 2 p1 x y) (1 + p3 r² + p4 r⁴)
    u = w / 2 + cx + x' (f + b1) + y' b2
    v = h / 2 + cy + y' f

For fisheyes x and y are first scaled so that r is the angle to the axis. OpenCV and COLMAP call p1 what is p2 here.
"""

import numpy as np

from jaxdr.untrusted import MOST_PIXELS, check_pixels, finite, shortened, whole
from jaxdr.views.layouts.colmap_tables import number_of
from jaxdr.views.layouts.matrices import ANEW, numbers_in
from jaxdr.views.lens import Lens
from jaxdr.xml_file import Node

FRAME, FISHEYES = "frame", ("fisheye", "equidistant_fisheye")
NUMBERS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
UNSEEN = 0.1  # pixels: what COLMAP's models do not have may move a picture's corner by so much
STEPS = 256  # radii at which a distortion is compared


def lens_of(sensor: Node, where: str) -> Lens:
    """The lens of a sensor. Raises ValueError, with `where`, for damaged numbers and for what COLMAP's models lack."""
    calibrations = sorted(sensor.all("calibration"), key=lambda node: node.attributes.get("class") != "adjusted")
    if not calibrations:
        raise ValueError(f"{where}: has no calibration; align the photographs, then export the cameras")
    calibration = calibrations[0]
    kind = calibration.attributes.get("type", sensor.attributes.get("type", FRAME))
    if kind not in (FRAME, *FISHEYES):
        raise ValueError(f"{where}: a {shortened(kind)} camera is not supported; export undistorted photographs")
    width, height = _size(calibration.first("resolution") or sensor.first("resolution"), where)
    if calibration.first("f") is None:
        raise ValueError(f"{where}: has no focal length f (old PhotoScan: fx); export from a newer version")
    values = {name: _value(calibration.first(name), f"{where}: {name}") for name in NUMBERS}
    f, k, p = values["f"], [values[f"k{i}"] for i in range(1, 5)], (values["p2"], values["p1"])
    if f < 1:
        raise ValueError(f"{where}: f must be at least one pixel, got {f:g}; {ANEW}")
    pixels = (f + values["b1"], f, 0.5 * width + values["cx"], 0.5 * height + values["cy"])
    reach = np.maximum(np.array(pixels[2:]), np.array([width, height]) - pixels[2:]) / f
    _check_left_out(values, float(reach[1]), float(np.hypot(*reach)), where)
    if kind != FRAME:
        if any(p):
            return Lens("THIN_PRISM_FISHEYE", (*pixels, *k[:2], *p, *k[2:], 0.0, 0.0), width, height)
        return Lens("OPENCV_FISHEYE", (*pixels, *k), width, height)
    if k[3]:
        above, below = _as_ratio(k, f, float(np.hypot(*reach)), where)
        return Lens("FULL_OPENCV", (*pixels, *above[:2], *p, above[2], *below), width, height)
    if k[2]:
        return Lens("FULL_OPENCV", (*pixels, *k[:2], *p, k[2], 0.0, 0.0, 0.0), width, height)
    if any(k) or any(p):
        return Lens("OPENCV", (*pixels, *k[:2], *p), width, height)
    return Lens.pinhole(pixels[:2], pixels[2:], (width, height))


def _check_left_out(values: dict[str, float], up: float, radius: float, where: str) -> None:
    """Raises ValueError if skew, or the tangential distortion of higher order, is seen in the pictures."""
    tangential = 3 * (abs(values["p1"]) + abs(values["p2"])) * radius**2
    higher = values["f"] * tangential * (abs(values["p3"]) * radius**2 + abs(values["p4"]) * radius**4)
    for moved, what in ((abs(values["b2"]) * up, "b2 (skew)"), (higher, "p3 and p4")):
        if not moved <= UNSEEN:
            raise ValueError(
                f"{where}: {what} must be zero, it moves pixels by {moved:.3g}; optimize the cameras without, or "
                "export undistorted photographs"
            )


def _as_ratio(k: list[float], f: float, radius: float, where: str) -> tuple[list[float], list[float]]:
    """(k1, k2, k3), (k4, k5, k6) of OpenCV, whose distortion is a ratio of polynomials of third degree in r².

    They are fitted to Metashape's polynomial of fourth degree out to the picture's corner, whose distorted `radius` is
    given. Raises ValueError if the fit differs visibly, and if the polynomial does not reach the corner.
    """
    r = np.linspace(0, 3 * radius, 3 * STEPS + 1)[1:]
    bent = np.polyval([*reversed(k), 1.0], r**2)
    reached = np.flatnonzero(r * bent >= radius)
    if not (len(reached) and (np.diff(r * bent)[: reached[0]] > 0).all()):
        raise ValueError(f"{where}: the distortion folds inside of the picture; calibrate the camera anew")
    last = r[reached[0]]
    r = last * np.sin(np.linspace(0, np.pi / 2, STEPS + 1)[1:])  # denser at the corner, where a fit is worst
    bent = np.polyval([*reversed(k), 1.0], r**2)
    powers = (r / last)[:, None] ** [2, 4, 6]
    both = np.hstack([powers, -bent[:, None] * powers])
    found, *_ = np.linalg.lstsq(r[:, None] * both, r * (bent - 1), rcond=None)
    above, below = found[:3], found[3:]
    differs = f * np.max(np.abs(r * ((1 + powers @ above) / (1 + powers @ below) - bent)))
    if not (differs <= UNSEEN and (1 + powers @ below > 0).all()):
        raise ValueError(
            f"{where}: k4 = {k[3]:g} has no match in COLMAP's models, pixels differ by {differs:.3g}; optimize the "
            "cameras without k4"
        )
    scale = last ** np.array([2, 4, 6])
    return (above / scale).tolist(), (below / scale).tolist()


def _size(resolution: Node | None, where: str) -> tuple[int, int]:
    if resolution is None:
        raise ValueError(f"{where}: has no resolution; {ANEW}")
    sides = (number_of(resolution.attributes.get(side, ""), f"{where}: its {side}") for side in ("width", "height"))
    width, height = (whole(int(finite(side, where, 1, MOST_PIXELS)), where) for side in sides)
    check_pixels(width, height, where)
    return width, height


def _value(node: Node | None, where: str) -> float:
    return 0.0 if node is None else numbers_in(node.text, 1, where)[0]
