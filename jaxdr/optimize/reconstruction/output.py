"""The folder of a reconstruction: what is written where."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.atomic_file import atomic_path
from jaxdr.image_formats.exr import is_available as has_openexr
from jaxdr.images import diverging, labelled_grid, save_png, to_srgb, write_image
from jaxdr.optimize.reconstruction.config import ReconstructConfig
from jaxdr.optimize.reconstruction.pictures import Cut
from jaxdr.optimize.run_files import STEP_PICTURES, RunFiles
from jaxdr.views.inputs import input_files
from jaxdr.views.pictures import PictureFile
from jaxdr.views.record import View, Views

DIFFERENCE = 0.25  # of encoded grey values: the ends of the colours of differences
COLUMNS = ("step", "level", "loss", "gradient_norm", "vertices", "seconds")


class OutputFolder(RunFiles):
    """Names and formats of what a reconstruction writes.

    `asset.glb`, `light.exr` (`light.hdr` without OpenEXR), `transforms.json` (the cameras), `test/` (renderings of the
    held-out views), `compared/` (photographs beside them), `masks/` (those that were made), `turntable.gif`,
    `report.html` and `metrics.json` in the end;
    `metrics.csv` (a line a step), `pictures/`, `checkpoint.npz` on the way.
    """

    kind = "reconstruction"
    free = ("output", "report", "memory", "asset")
    subfolders = ("pictures", "test", "compared")

    def __init__(self, config: ReconstructConfig, views: Views):
        super().__init__(config, COLUMNS)
        named = ("asset.glb", "light.exr", "light.hdr", "transforms.json", "turntable.gif")
        self.results = (
            *named,
            STEP_PICTURES,
            *(f"{place}/{view.name}.png" for place in ("test", "compared", "masks") for view in views.views),
        )
        self._inputs = {"photographs": views.folder} | input_files(views)

    @property
    def inputs(self) -> Mapping[str, Path]:
        """The folder, and the files in it: photographs, masks and cameras."""
        return self._inputs

    @property
    def light(self) -> Path:
        """Where the light is."""
        return self.path / ("light.exr" if has_openexr() else "light.hdr")

    def save_picture(self, step: int, shown: Float[np.ndarray, "H W 4"], photograph: Cut) -> None:
        """`pictures/STEP.png`: a photograph, and what a step saw in its place (few samples), both over black."""
        row = [to_srgb(photograph.color), to_srgb(shown[..., :3])]
        save_png(self.path / "pictures" / f"{step:05d}.png", labelled_grid(["photograph", "rendering"], [row]))

    def mask(self, view: View) -> Path | None:
        """The mask of a photograph: a person's own, or the one that was made and is in this folder; None without."""
        made = isinstance(view.picture, PictureFile) and view.picture.made is not None
        return self.path / "masks" / f"{view.name}.png" if made else view.mask

    def save_masks(self, views: Sequence[View]) -> None:
        """`masks/NAME.png`: those that were made. They can be looked at, mended, and given back as a person's own."""
        made = [view for view in views if isinstance(view.picture, PictureFile) and view.picture.made is not None]
        for view in made:
            assert isinstance(view.picture, PictureFile)
            path = self.path / "masks" / f"{view.name}.png"
            path.parent.mkdir(exist_ok=True)
            with atomic_path(path) as temporary:
                pixels = 255 * view.picture.made_in_file().astype(np.uint8)
                Image.fromarray(pixels).save(temporary, format="PNG")

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

    def save_compared(self, view: View, picture: Float[np.ndarray, "H W 4"]) -> None:
        """`compared/NAME.png`: photograph, rendering and difference, over black. Red: the rendering is too bright."""
        photograph, rendering = to_srgb(view.over_black), to_srgb(picture[..., :3])
        difference = (rendering.astype(float) - photograph).mean(-1) / 255
        row = [photograph, rendering, diverging(difference, DIFFERENCE)]
        titles = ["photograph", "rendering", "difference"]
        save_png(self.path / "compared" / f"{view.name}.png", labelled_grid(titles, [row]))

    def save_light(self, radiance: Float[np.ndarray, "H W 3"]) -> None:
        """The light, linear."""
        write_image(self.light, radiance)
