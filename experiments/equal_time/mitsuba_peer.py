"""Mitsuba's half: the finite-difference reference and the derivative images of `direct_projective`."""

import time

import numpy as np
from tqdm import tqdm

SPP_PER_BATCH = 1024


class MovingScene:
    """A scene whose shape moves along x; needs an LLVM that Dr.Jit finds (DRJIT_LIBLLVM_PATH)."""

    def __init__(self, path, case):
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        mi.set_log_level(mi.LogLevel.Error)
        self.dr, self.mi = dr, mi
        self.scene = mi.load_file(str(path))
        self.parameters = mi.traverse(self.scene)
        self.name = f"{case.shape}.vertex_positions"
        self.rest = dr.unravel(mi.Point3f, self.parameters[self.name])
        dr.eval(self.rest)

    def move(self, offset):
        """Put the shape `offset` (a mi.Float, scene units) along x from where the file has it."""
        self.parameters[self.name] = self.dr.ravel(self.rest + self.mi.Vector3f(offset, 0, 0))
        self.parameters.update()

    def image(self, offset, spp, seed, integrator):
        """[H, W, 3] image of the moved scene."""
        self.move(self.mi.Float(offset))
        return np.array(self.mi.render(self.scene, integrator=integrator, spp=spp, seed=seed), float)

    def derivative(self, offset, spp, seed, integrator):
        """([H, W, 3] d image / d offset, seconds). Timed is the derivative alone: no image, no move of the scene."""
        dr, mi = self.dr, self.mi
        x = mi.Float(offset)
        dr.enable_grad(x)
        self.move(x)
        dr.forward(x, dr.ADFlag.ClearEdges)
        dr.eval(dr.grad(self.parameters[self.name]))
        dr.sync_thread()
        start = time.perf_counter()
        answer = np.array(integrator.render_forward(self.scene, params=self.parameters, spp=spp, seed=seed), float)
        return answer, time.perf_counter() - start


def reference(path, case, batches):
    """Central difference with common random numbers: a dict with the image and the variance of its noise.

    (I(h) − I(−h)) / 2h is exactly the mean of dI/dx over [−h, h], even if it jumps there. So estimators are evaluated
    at offsets spread over the same interval, and the step smears both sides of the comparison equally.
    """
    scene = MovingScene(path, case)
    integrator = scene.mi.load_dict({"type": "path", "max_depth": case.max_depth, "rr_depth": 1000})
    total = square = 0.0
    for seed in tqdm(range(batches), desc=f"reference {case.name}", leave=False):
        ahead = scene.image(case.step, SPP_PER_BATCH, seed, integrator)
        behind = scene.image(-case.step, SPP_PER_BATCH, seed, integrator)
        difference = (ahead - behind) / (2 * case.step)
        total, square = total + difference, square + difference**2
    mean = total / batches
    variance = (square / batches - mean**2) / (batches - 1)
    return {"image": mean, "noise_variance": variance.mean(), "step": case.step, "batches": batches}


def estimates(path, case, guiding, spp, offsets, seeds):
    """Derivative images [offsets, seeds, H, W, 3], seconds of each call, seconds of the first (compiling) call."""
    scene = MovingScene(path, case)
    settings = {"type": "direct_projective", "guiding": guiding}
    if case.max_depth > 2:
        settings = {"type": "prb_projective", "guiding": guiding, "max_depth": case.max_depth, "rr_depth": 1000}
    if not case.directly_visible:
        settings |= {"sppc": 0, "sppp": 0}  # terms that are zero in this picture: leave Mitsuba its best time
    integrator = scene.mi.load_dict(settings)
    _, first = scene.derivative(offsets[0], spp, 12345, integrator)
    scene.derivative(offsets[0], spp, 12346, integrator)
    images, seconds = [], []
    for i, offset in enumerate(tqdm(offsets, desc=f"{case.name} {guiding} {spp} spp", leave=False)):
        calls = [scene.derivative(offset, spp, 1 + i * seeds + j, integrator) for j in range(seeds)]
        images.append([image for image, _ in calls])
        seconds += [t for _, t in calls]
    return np.array(images), seconds, first
