"""How far recovered parameters are from those of a known target."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.aovs import render_aovs
from jaxdr.compilation import jit
from jaxdr.optimize.chamfer import chamfer
from jaxdr.optimize.recovery.config import RecoveryConfig
from jaxdr.optimize.recovery.parameters import Motion, angle_between
from jaxdr.optimize.recovery.problem import Latents, Problem
from jaxdr.scene.scene import Scene, every_parameter

ALBEDO_SPP = 16


class Errors:
    """Measures of a run, by column of its metrics: `names`; there are none where the target is not known.

    - `<name> angle`, in degrees, and `<name> distance`, in scene units: of a matrix, as far as it moves;
    - `<shape>.vertices distance`: of vertices that move as a whole, root mean square, in scene units;
    - `<shape>.vertices chamfer`: of others, see `jaxdr.chamfer`;
    - `albedo`: of all textures on surfaces, root mean square over the pixels of all views that see a shape (texels of
      different UVs can't be compared);
    - `<name>`: of anything else, root mean square over the components.
    """

    def __init__(self, problem: Problem, config: RecoveryConfig):
        self.problem, self.samples = problem, config.report.chamfer_samples
        self.key = jax.random.key(config.seed)
        self.names: list[str] = []
        if problem.target is None:
            return
        self.true = every_parameter(problem.target)
        textures = False
        for name, parameter in problem.parameters.items():
            if name.endswith(("pixels", "colors")) and ".bsdf." in name:
                textures = True
            elif name not in self.true:
                continue
            elif name.endswith(".vertices"):
                whole = isinstance(parameter, Motion) and self.true[name].shape == parameter.rest.shape
                self.names.append(f"{name} {'distance' if whole else 'chamfer'}")
            elif isinstance(parameter, Motion):
                self.names += [f"{name} angle"] if parameter.kind != "translation" else []
                self.names += [f"{name} distance"] if parameter.kind in ("rigid", "translation") else []
            elif self.true[name].shape == parameter.start().shape:
                self.names.append(name)
        if textures:
            self.names.append("albedo")
            self.albedo = jit(self._albedo)
            self.true_albedo = self._albedos(problem.target)

    def __call__(self, latents: Latents) -> dict[str, float]:
        """All measures by their names."""
        if not self.names:
            return {}
        values = self.problem.values(latents)
        return {column: self._error(column, values) for column in self.names}

    def _error(self, column: str, values: dict) -> float:
        name, _, kind = column.partition(" ")
        if column == "albedo":
            pairs = zip(self._albedos(self.problem.scene.replace(values)), self.true_albedo, strict=True)
            squared = [((a - b)[shape >= 0] ** 2).ravel() for (a, shape), (b, _) in pairs]
            return float(np.sqrt(np.concatenate(squared).mean()))
        value, true = np.asarray(values[name], np.float64), np.asarray(self.true[name], np.float64)
        if kind == "angle":
            return angle_between(value, true)
        if kind == "chamfer":
            shape = name.removesuffix(".vertices")
            mesh = self.problem.scene.shapes[shape].mesh.with_vertices(values[name])
            return chamfer(mesh, self.problem.target.shapes[shape].mesh, self.samples)
        if kind == "distance" and value.shape == (4, 4):
            value, true = value[:3, 3], true[:3, 3]
        per_point = (value - true) ** 2
        return float(np.sqrt(per_point.sum(-1).mean() if kind == "distance" else per_point.mean()))

    def _albedo(self, scene: Scene, to_world) -> dict:
        pose = {"camera.to_world": to_world}
        return render_aovs(scene.replace(pose), self.key, spp=ALBEDO_SPP, names=("albedo", "shape"))

    def _albedos(self, scene: Scene) -> list[tuple[np.ndarray, np.ndarray]]:
        found = [self.albedo(scene, jnp.asarray(view, float)) for view in self.problem.views]
        return [(np.asarray(f["albedo"]), np.asarray(f["shape"])) for f in found]
