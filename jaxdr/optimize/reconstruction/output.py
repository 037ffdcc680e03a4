"""The folder of a reconstruction: what is written where."""

import csv
import json
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.image_formats.exr import is_available as has_openexr
from jaxdr.images import atomic_path, labelled_grid, save_png, to_srgb, write_image
from jaxdr.optimize.reconstruction.config import ReconstructConfig
from jaxdr.optimize.reconstruction.pictures import Cut
from jaxdr.optimize.results_folder import open_results

COLUMNS = ("step", "level", "loss", "gradient_norm", "vertices", "seconds")


class OutputFolder:
    """Names and formats of what a reconstruction writes.

    `asset.glb`, `light.exr` (`light.hdr` without OpenEXR), `transforms.json` (the cameras), `test/` (renderings of the
    held-out views), `report.html`, `turntable.gif`, `metrics.json` in the end; `metrics.csv` (a line a step),
    `pictures/`, `checkpoint.npz` on the way.
    """

    def __init__(self, path: Path, config: ReconstructConfig):
        self.path, self.config = path, config

    @property
    def checkpoint(self) -> Path:
        """Where the checkpoint is."""
        return self.path / "checkpoint.npz"

    @property
    def finished(self) -> bool:
        """Whether the run came to its end."""
        return (self.path / "metrics.json").exists()

    @property
    def light(self) -> Path:
        """Where the light is."""
        return self.path / ("light.exr" if has_openexr() else "light.hdr")

    def opened(self, resume: bool, overwrite: bool) -> "OutputFolder":
        """Make the folder, or check that it is the one to go on with; raises ValueError, see `open_results`."""
        free = ("output", "report")  # how often the folder is written to doesn't change the result
        open_results(self.path, self.config, resume, overwrite, kind="reconstruction", free=free)
        for name in ("pictures", "test"):
            (self.path / name).mkdir(exist_ok=True)
        return self

    def start_metrics(self, done: int) -> None:
        """Begin `metrics.csv`, or drop the lines of steps that will be done again."""
        path = self.path / "metrics.csv"
        lines = [",".join(COLUMNS)]
        if done > 0 and path.exists():
            lines += [line for line in path.read_text().splitlines()[1:] if int(line.partition(",")[0]) <= done]
        self.write_text("metrics.csv", "\n".join(lines) + "\n")

    def add_metrics(self, row: dict) -> None:
        """Append a line to `metrics.csv`."""
        with open(self.path / "metrics.csv", "a", newline="") as file:
            csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(row)

    def save_picture(self, step: int, shown: Float[np.ndarray, "H W 4"], photograph: Cut) -> None:
        """`pictures/STEP.png`: a photograph, and what a step saw in its place (few samples), both over black."""
        row = [to_srgb(photograph.color), to_srgb(shown[..., :3])]
        save_png(self.path / "pictures" / f"{step:05d}.png", labelled_grid(["photograph", "rendering"], [row]))

    def save_test(self, name: str, picture: Float[np.ndarray, "H W 4"], alpha: bool) -> None:
        """`test/NAME.png`: sRGB; with `alpha`, by which colours then are not multiplied, or without."""
        color, cover = picture[..., :3], picture[..., 3:]
        if alpha:
            straight = to_srgb(color / np.where(cover > 0, cover, 1.0))
            pixels = np.concatenate([straight, np.round(255 * cover).astype(np.uint8)], -1)
        else:
            pixels = to_srgb(color)
        path = self.path / "test" / f"{name}.png"
        with atomic_path(path) as temporary:
            Image.fromarray(pixels).save(temporary, format="PNG")

    def save_light(self, radiance: Float[np.ndarray, "H W 3"]) -> None:
        """The light, linear."""
        write_image(self.light, radiance)

    def save_summary(self, summary: dict) -> None:
        """Write `metrics.json`."""
        self.write_text("metrics.json", json.dumps(summary, indent=2) + "\n")

    def write_text(self, name: str, text: str) -> None:
        """A file of text that appears complete or not at all."""
        with atomic_path(self.path / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
