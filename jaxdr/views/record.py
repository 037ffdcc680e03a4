"""A photograph with a known camera, and a set of such photographs."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxdr.scene.camera import Perspective
from jaxdr.scene.film import Box, Film
from jaxdr.views.lens import Lens
from jaxdr.views.pictures import Colors, PictureFile, Pixels


@dataclass(frozen=True, eq=False)
class View:
    """One photograph, as its pinhole camera sees it: see `jaxdr.load_views` for what is done to files.

    - `name`: the name of its file without suffix; `path`: the file.
    - `picture`: its pixels, in a file or in memory; `image` and `alpha` read them.
    - `to_world`: camera to world; the columns are left, up, forward, position, as in `jaxdr.look_at`.
    - `focal`: focal length, in pixels; `centre`: principal point, in pixels from the upper left corner.
    - `held_out`: kept for evaluation, never used in fitting.
    - `backdrop`: whether the picture shows what is behind the object. A picture that its own alpha cuts out does not.
      In one with a mask, pixels at the border of the mask show the object and what is behind it, mixed.
    """

    name: str
    path: Path
    picture: Pixels | PictureFile
    to_world: Float[np.ndarray, "4 4"]
    focal: float
    centre: tuple[float, float]
    held_out: bool = False
    backdrop: bool = True

    @property
    def image(self) -> Float[np.ndarray, "H W 3"]:
        """Linear RGB, not multiplied by alpha. Raises ValueError, with the file, if it can't be read."""
        return self.picture.read()[0]

    @property
    def alpha(self) -> Float[np.ndarray, "H W"] | None:
        """Share of each pixel that the object covers, in [0, 1]; None if unknown. Raises ValueError as `image` does."""
        return self.picture.read()[1] if self.masked else None

    @property
    def masked(self) -> bool:
        """Whether there is alpha. Nothing is read for that."""
        return self.picture.masked

    @property
    def mask(self) -> Path | None:
        """The file of its mask; None where alpha is in the picture, in memory, or unknown."""
        return self.picture.mask if isinstance(self.picture, PictureFile) else None

    @property
    def lens(self) -> Lens:
        """The lens of the picture's file; the pinhole itself for pixels in memory."""
        if isinstance(self.picture, PictureFile):
            return self.picture.lens
        return Lens.pinhole(self.focal, self.centre, (self.width, self.height))

    @property
    def width(self) -> int:
        """Width, in pixels."""
        return self.picture.width

    @property
    def height(self) -> int:
        """Height, in pixels."""
        return self.picture.height

    @property
    def fov(self) -> float:
        """Horizontal field of view, in degrees."""
        return float(np.degrees(2 * np.arctan(0.5 * self.width / self.focal)))

    @property
    def principal_point(self) -> tuple[float, float]:
        """Principal point as `jaxdr.Perspective` takes it: offset to the left and up, in shares of width and height."""
        return 0.5 - self.centre[0] / self.width, 0.5 - self.centre[1] / self.height

    @property
    def camera(self) -> Perspective:
        """The camera, with a box filter: a pixel of a photograph collects the light of its own square only."""
        film = Film(self.width, self.height, Box())
        return Perspective(self.to_world, self.fov, film, principal_point=self.principal_point)

    def project(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, " N"], ...]:
        """(x, y, depth) of points of the world on the host; pixels, which mean nothing unless the depth is positive."""
        local = (points - self.to_world[:3, 3]) @ self.to_world[:3, :3]
        depth = local[:, 2]
        ahead = np.where(depth > 0, depth, 1.0)
        x = self.centre[0] - self.focal * local[:, 0] / ahead
        y = self.centre[1] - self.focal * local[:, 1] / ahead
        return x, y, depth

    def pixels(
        self, points: Float[np.ndarray, "N 3"]
    ) -> tuple[Bool[np.ndarray, " N"], Int[np.ndarray, " N"], Int[np.ndarray, " N"]]:
        """(whether it is in the picture, row, column) of points of the world on the host; zeros where it is not."""
        x, y, depth = self.project(points)
        framed = (depth > 0) & (x >= 0) & (y >= 0) & (x < self.width) & (y < self.height)
        row, column = (np.where(framed, value, 0).astype(int) for value in (y, x))
        return framed, row, column

    @property
    def over_black(self) -> Float[np.ndarray, "H W 3"]:
        """Linear RGB of the object over black."""
        return over_black(*self.cut_out())

    def cut_out(self) -> Colors:
        """(linear RGB, alpha or None): what a rendering of the object is compared with.

        A picture with a backdrop is cut out as with scissors: pixels count in full where alpha is above one half.
        """
        image, alpha = self.picture.read()
        return image, scissors(alpha) if self.backdrop and alpha is not None else alpha

    def with_picture(self, image: Float[np.ndarray, "H W 3"], alpha: Float[np.ndarray, "H W"] | None) -> "View":
        """The same camera with other pixels, in memory, which `alpha` cuts out."""
        return replace(self, picture=Pixels(image, alpha), backdrop=alpha is None)


@dataclass(frozen=True, eq=False)
class Views:
    """Photographs of one object. `fitted` are those to fit, `held_out` those for evaluation."""

    folder: Path
    views: tuple[View, ...]

    @property
    def fitted(self) -> tuple[View, ...]:
        """The photographs to fit."""
        return tuple(view for view in self.views if not view.held_out)

    @property
    def held_out(self) -> tuple[View, ...]:
        """The photographs for evaluation."""
        return tuple(view for view in self.views if view.held_out)

    @property
    def masked(self) -> bool:
        """Whether every photograph has alpha."""
        return all(view.masked for view in self.views)

    def _repr_html_(self) -> str:
        """Number, sizes and a few small pictures, for notebooks."""
        from jaxdr.views.thumbnails import views_html  # it needs this module

        return views_html(self)


def in_mask(view: View, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, " N"]:
    """Whether points of the world are inside of a photograph's mask, on the host."""
    framed, row, column = view.pixels(points)
    return framed & (np.asarray(view.alpha)[row, column] > 0.5)


def over_black(image: Float[np.ndarray, "H W 3"], alpha: Float[np.ndarray, "H W"] | None) -> Float[np.ndarray, "H W 3"]:
    """Colours multiplied by alpha, if there is one. Where alpha is zero they are zero, even if the picture is NaN."""
    return image if alpha is None else np.where(alpha[..., None] == 0, image.dtype.type(0), image) * alpha[..., None]


def scissors(alpha: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """1 where alpha is above one half, else 0."""
    return (alpha > 0.5).astype(alpha.dtype)


def common_point(poses: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "3"]:
    """The point nearest to the axes of all cameras (least squares).

    For one camera, or for parallel axes, many points are nearest. It is the one closest to the mean of the cameras.
    """
    forward, origin = poses[:, :3, 2], poses[:, :3, 3]
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]
    mean = origin.mean(0)
    offset = np.einsum("nij,nj->i", across, origin - mean)
    return mean + np.linalg.lstsq(across.sum(0), offset, rcond=1e-6)[0]
