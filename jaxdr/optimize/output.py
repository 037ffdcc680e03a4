"""The folder of a run: metrics, pictures, meshes, checkpoint."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxdr.atomic_file import atomic_path
from jaxdr.boundary import ESTIMATORS
from jaxdr.geometry.load import save_mesh
from jaxdr.geometry.mesh import Mesh
from jaxdr.images import diverging, labelled_grid, save_png, to_srgb
from jaxdr.optimize.run_files import AGAIN, STEP_PICTURES, RunFiles
from jaxdr.plan.report import Plan, estimators_in
from jaxdr.untrusted import array_of, json_text, read_json, shortened

COLUMNS = (
    "iteration",
    "loss",
    "gradient_norm",
    "seconds",
    "vertices",
    "chamfer",
    "folded",
    "level",
    "signal_to_noise",
)


class RunFolder(RunFiles):
    """Names and formats of everything that a run of `jaxdr optimize` writes.

    - `metrics.csv`: a line for every step.
    - `pictures/`, `meshes/`: grids, and GLB files of the state after so many steps.
    - `checkpoint.npz`: what `resume` needs; `plan.json` too, where the integrator was left to `jaxdr.plan`.
    - `metrics.json`: the summary of a finished run.
    """

    subfolders = ("pictures", "meshes")
    results = (
        *("plan.json", "targets.npy", "targets_[0-9]*.npy", "result.npz"),
        *(STEP_PICTURES, "meshes/[0-9][0-9][0-9][0-9][0-9]*.glb", "meshes/target.glb", "meshes/result.glb"),
    )

    def __init__(self, config: Any, columns: Sequence[str] = COLUMNS, kind: str = "shape optimisation"):
        super().__init__(config, columns)
        self.kind = kind

    def targets(self, level: int | None = None) -> Path:
        """Where the target views are, once all of them were rendered; those of a coarse level have a file each."""
        return self.path / ("targets.npy" if level is None else f"targets_{level}.npy")

    def save_targets(self, targets: Float[np.ndarray, "N H W 3"], level: int | None = None) -> None:
        """Keep the target views: a resumed run needs the very same."""
        with atomic_path(self.targets(level)) as temporary:
            np.save(temporary, targets)

    def load_targets(self, level: int | None = None) -> Float[np.ndarray, "N H W 3"]:
        """The target views. Raises ValueError when they are missing or damaged."""
        path = self.targets(level)
        try:
            found = array_of(path, str(path))
            if found.ndim != 4 or 0 in found.shape or found.shape[-1] != 3 or found.dtype.kind != "f":
                raise ValueError(
                    f"{path}: expected numbers of shape [N, H, W, 3], got {found.dtype}{list(found.shape)}"
                )
            return found
        except ValueError as problem:
            raise ValueError(f"{problem}; {AGAIN}") from None

    def save_plan(self, plan: Plan) -> None:
        """Write `plan.json`: a resumed run does not measure again."""
        self.write_text("plan.json", json_text(plan.to_dict()))

    def load_plan(self, allowed: Sequence[str]) -> Plan | None:
        """The plan that the run was begun with, if one was made.

        A plan may name an estimator in a file or a module, whose code is run. Only those in `allowed`, which the config
        names, are taken from a folder. Raises ValueError for others, and for a plan that is damaged.
        """
        path = self.path / "plan.json"
        if not path.exists():
            return None
        try:
            plan = read_json(path)
            named = estimators_in(plan["integrator"]["boundary"])
        except ValueError as problem:
            raise ValueError(f"{problem}; {AGAIN}") from None
        except (TypeError, KeyError):
            raise ValueError(f"{path}: is damaged, it is no plan; {AGAIN}") from None
        others = [kind for kind in named if kind not in (*ESTIMATORS, *allowed)]
        if others:
            raise ValueError(
                f"{path}: names the estimator {shortened(others[0])}, which the config does not name; code is run only "
                f"where a config names it. Name it there, or {AGAIN}"
            )
        try:
            return Plan.from_dict(plan)
        except ValueError as problem:
            raise ValueError(f"{path}: can't be read ({problem}); {AGAIN}") from None

    def save_grid(
        self, iteration: int, targets: Float[np.ndarray, "N H W 3"], images: Float[np.ndarray, "M H W 3"]
    ) -> None:
        """Picture of some views in rows: target, current, and the difference of their grey values.

        The exposure maps the 99th percentile of the targets to 1; the difference is red where the current image is
        too bright, blue where it is too dark, saturated at half that value.
        """
        white = max(float(np.percentile(targets, 99)), 1e-12)
        rows = []
        for target, image in zip(targets, images, strict=False):
            difference = diverging((image - target).mean(-1), 0.5 * white)
            rows.append([to_srgb(target / white), to_srgb(image / white), difference])
        save_png(
            self.path / "pictures" / f"{iteration:05d}.png", labelled_grid(["target", "current", "difference"], rows)
        )

    def save_mesh(self, name: str, mesh: Mesh) -> None:
        """Write `meshes/<name>.glb`."""
        path = self.path / "meshes" / f"{name}.glb"
        with atomic_path(path) as temporary:
            save_mesh(temporary, mesh)

    def save_texture(self, name: str, pixels: Float[np.ndarray, "H W C"]) -> None:
        """Write `pictures/<name>.png`, enlarged texels of linear colours."""
        colors = to_srgb(np.broadcast_to(pixels, (*pixels.shape[:2], 3)))
        factor = max(1, 256 // len(colors))
        save_png(self.path / "pictures" / f"{name}.png", colors.repeat(factor, 0).repeat(factor, 1))

    def save_values(self, values: dict[str, np.ndarray]) -> None:
        """Write `result.npz`: parameters of the scene by name."""
        with atomic_path(self.path / "result.npz") as temporary:
            np.savez(temporary, allow_pickle=False, **values)


def views_to_show(shown: int, views: int) -> list[int]:
    """Numbers of the views in the picture grids, spread over all views."""
    return [int(i) for i in np.linspace(0, views - 1, min(shown, views)).round()]
