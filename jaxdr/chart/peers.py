"""Mitsuba's projective integrators as lines of the chart. They need the extra `peers`, and an LLVM for Dr.Jit."""

import importlib.util
import time
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxdr.chart.config import ChartScene, Motion

GUIDING = {"Mitsuba, unguided": "none", "Mitsuba, octree": "octree"}


def require_mitsuba() -> None:
    """Raises ImportError, which says what to install, if Mitsuba is missing or finds no LLVM."""
    if importlib.util.find_spec("mitsuba") is None:
        raise ImportError('peers = true needs Mitsuba, which is optional: pip install -e ".[peers]"')
    import mitsuba as mi  # pyright: ignore[reportMissingImports]

    try:
        mi.set_variant("llvm_ad_rgb")
        mi.Float(0.0) + 1  # pyright: ignore  the library is loaded when it is first used
    except Exception as problem:
        first = (str(problem).splitlines() or [""])[0]
        raise ImportError(f"peers = true: Mitsuba finds no LLVM ({first}); set DRJIT_LIBLLVM_PATH") from None
    mi.set_log_level(mi.LogLevel.Error)


class PeerLine:
    """One of Mitsuba's integrators on one scene: `direct_projective` for direct light, otherwise `prb_projective`."""

    def __init__(self, scene: ChartScene, name: str):
        import drjit as dr  # pyright: ignore[reportMissingImports]
        import mitsuba as mi  # pyright: ignore[reportMissingImports]

        self.dr, self.mi, self.name, self.motion = dr, mi, name, scene.motion
        variables: dict[str, Any] = {k: str(v) for k, v in scene.options.items()}
        self.scene = mi.load_file(scene.file, **variables)
        self.parameters = mi.traverse(self.scene)
        self.key = f"{scene.motion.shape}.vertex_positions"
        self.rest = np.array(self.parameters[self.key], np.float64).reshape(-1, 3)
        settings: dict[str, Any] = {"type": "direct_projective", "guiding": GUIDING[name]}
        if scene.max_depth != 2:
            settings |= {"type": "prb_projective", "max_depth": scene.max_depth, "rr_depth": 1000}
        if not scene.directly_visible:
            settings |= {"sppc": 0, "sppp": 0}
        self.integrator = mi.load_dict(settings)

    def timed(self, spp: int, t: float, seed: int) -> tuple[Float[np.ndarray, "H W 3"], float]:
        """(derivative image at t, seconds). The time includes the update of the scene and the building of the guide."""
        dr, mi = self.dr, self.mi
        position, velocity = rigid(self.motion, self.rest, t)
        position, velocity = (mi.Point3f(np.ascontiguousarray(array.T, np.float32)) for array in (position, velocity))
        dr.eval(position, velocity)
        dr.sync_thread()
        start = time.perf_counter()
        x = mi.Float(0.0)
        dr.enable_grad(x)
        self.parameters[self.key] = dr.ravel(position + x * velocity)
        self.parameters.update()
        dr.forward(x, dr.ADFlag.ClearEdges)
        image = self.integrator.render_forward(self.scene, params=self.parameters, spp=spp, seed=seed)
        answer = np.array(image, np.float32)
        dr.sync_thread()
        return answer, time.perf_counter() - start


def rigid(
    motion: Motion, rest: Float[np.ndarray, "V 3"], t: float
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]:
    """(positions, velocities) of Mitsuba's vertices at t. They may differ from ours: seams may double vertices."""
    if motion.kind == "translate":
        velocity = np.broadcast_to(np.array(motion.direction, float), rest.shape)
        return rest + t * velocity, velocity
    axis = np.array(motion.axis, float) / np.linalg.norm(motion.axis)
    pivot = (rest.min(0) + rest.max(0)) / 2 if motion.pivot is None else np.array(motion.pivot, float)
    arm = rest - pivot
    along = (arm @ axis)[:, None] * axis
    turned = along + np.cos(t) * (arm - along) + np.sin(t) * np.cross(axis, arm)
    return pivot + turned, np.cross(axis, turned)
