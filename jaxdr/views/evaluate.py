"""How well renderings agree with photographs: PSNR, SSIM, and overlap of masks."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxdr.argument_kinds import checked
from jaxdr.html_summary import summary as html_summary
from jaxdr.html_summary import table
from jaxdr.images import to_srgb
from jaxdr.integrators import Integrator
from jaxdr.scene.scene import Scene
from jaxdr.views.record import View, Views, over_black
from jaxdr.views.rendering import each_rendered

UNSCALED = np.ones(3)


class Score(NamedTuple):
    """Agreement of one rendering with its photograph: `psnr` in dB, `ssim`, and `iou` of the masks or None.

    PSNR and SSIM are of 8-bit sRGB, over black where the photograph has a mask or alpha. Pixels at the border of a mask
    show what is behind the object, too, in the photograph and in the rendering. Both are NaN if a pixel that counts is
    NaN. `psnr_inside` is of the pixels inside of the mask alone, None without masks: the rest is black in both.
    """

    name: str
    psnr: float
    ssim: float
    iou: float | None
    psnr_inside: float | None = None


class Evaluation(NamedTuple):
    """Scores of several views. `scale`: RGB factors that the renderings were multiplied by."""

    scores: tuple[Score, ...]
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def to_dict(self) -> dict:
        """Mean and worst of every figure, and the figures of the views."""
        summary: dict = {}
        for name in ("psnr", "ssim", "iou", "psnr_inside"):
            values = [getattr(score, name) for score in self.scores]
            if None not in values:
                summary[name] = {"mean": float(np.mean(values)), "worst": float(np.min(values))}
        return {**summary, "scale": list(self.scale), "views": [score._asdict() for score in self.scores]}

    def _repr_html_(self) -> str:
        """Mean and worst figures, and those of the views, as a table, for notebooks."""
        found = self.to_dict()
        figures = {
            "psnr": ("PSNR, dB", 1),
            "psnr_inside": ("PSNR inside, dB", 1),
            "ssim": ("SSIM", 3),
            "iou": ("IoU", 3),
        }
        shown = {name: words for name, words in figures.items() if name in found}
        numbers = [(kind, {name: found[name][kind] for name in shown}) for kind in ("mean", "worst")]
        numbers += [(score.name, score._asdict()) for score in self.scores]
        rows = [
            (name, *(f"{row[figure]:.{digits}f}" for figure, (_, digits) in shown.items())) for name, row in numbers
        ]
        return html_summary("Evaluation", table(("view", *(words for words, _ in shown.values())), rows))


@checked
def evaluate_views(
    scene: Scene,
    views: Views | Sequence[View],
    *,
    spp: int = 64,
    seed: int = 0,
    match_channels: bool = False,
    integrator: Integrator | None = None,
) -> Evaluation:
    """Scores of a scene, rendered from the cameras of photographs: PSNR, SSIM, and overlap of masks.

    - `views`: `Views`, of which the held-out ones are taken, or a list, of which all are taken.
    - `spp`: samples per pixel.
    - `match_channels`: first multiply the renderings by one factor for each colour channel, the same in all views. Use
      it if the photographs were taken under another sky, whose brightness is unknown.
    - `integrator`: default as in `render`.

    Put the sky into the scene (`environment`). `to_dict()` of the result has mean and worst of every figure. Raises
    ValueError if there is no view, and ImportError if scikit-image is missing.
    """
    chosen = views.held_out if isinstance(views, Views) else tuple(views)
    require_skimage()
    if not chosen:
        raise ValueError("evaluate_views: there is no view to judge by; hold some out (load_views, holdout=...)")
    pictures = each_rendered(scene, chosen, spp, seed, integrator, "evaluate_views")
    if match_channels:  # the factors depend on all pictures
        return score_pictures(list(pictures), chosen, match_channels=True)
    return Evaluation(tuple(score_picture(picture, view) for picture, view in zip(pictures, chosen, strict=True)))


def score_pictures(
    pictures: Sequence[Float[np.ndarray, "H W 4"]], views: Sequence[View], *, match_channels: bool = False
) -> Evaluation:
    """Scores of pictures (linear RGB multiplied by alpha, and alpha), one for each photograph; see `evaluate_views`.

    Raises ValueError unless there is a picture of the right size for every photograph.
    """
    if len(pictures) != len(views) or not views:
        raise ValueError(f"score_pictures: {len(pictures)} pictures for {len(views)} photographs; give one each")
    for picture, view in zip(pictures, views, strict=True):
        _check_shape(picture, view)
    scale = channel_scale(pictures, views) if match_channels else np.ones(3)
    scores = [score_picture(picture, view, scale) for picture, view in zip(pictures, views, strict=True)]
    return Evaluation(tuple(scores), (float(scale[0]), float(scale[1]), float(scale[2])))


def _check_shape(picture: Float[np.ndarray, "H W 4"], view: View) -> None:
    if picture.shape != (view.height, view.width, 4):
        raise ValueError(
            f"score_pictures: the picture of {view.name} has shape {list(picture.shape)}, expected "
            f"{[view.height, view.width, 4]}"
        )


def channel_scale(pictures, views) -> Float[np.ndarray, "3"]:
    """The RGB factors that bring pictures closest to photographs (least squares), where those are not clipped."""
    above, below = np.zeros(3), np.zeros(3)
    for picture, view in zip(pictures, views, strict=True):
        image, alpha = view.cut_out()
        photograph = over_black(image, alpha).astype(float)
        mask = np.ones(image.shape[:2]) if alpha is None else alpha
        inside = (photograph.max(-1, keepdims=True) < 0.99) & (mask > 0.5)[..., None]
        above += np.where(inside, picture[..., :3] * photograph, 0.0).sum((0, 1))
        below += np.where(inside, picture[..., :3] ** 2, 0.0).sum((0, 1))
    return np.where(below > 0, above / np.where(below > 0, below, 1.0), 1.0)


def score_picture(picture: Float[np.ndarray, "H W 4"], view: View, scale: Float[np.ndarray, "3"] = UNSCALED) -> Score:
    """The score of one picture whose colours are multiplied by `scale`; see `score_pictures`."""
    structural_similarity = require_skimage()
    _check_shape(picture, view)
    image, alpha = view.cut_out()
    both = picture[..., :3] * scale, over_black(image, alpha)
    if any(np.isnan(x).any() for x in both):  # 8 bits have no NaN: it would count as black
        return Score(view.name, math.nan, math.nan, _overlap(picture, alpha), None if alpha is None else math.nan)
    rendered, photograph = (to_srgb(x).astype(float) / 255 for x in both)
    squares = (rendered - photograph) ** 2
    inside = None if alpha is None else decibels(squares[alpha > 0.5])
    size = min(11, view.height, view.width)
    ssim: Any = structural_similarity(
        rendered,
        photograph,
        data_range=1.0,
        channel_axis=2,
        win_size=size - 1 + size % 2,
        gaussian_weights=size == 11,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return Score(view.name, decibels(squares), float(ssim), _overlap(picture, alpha), inside)


def decibels(squares: Float[np.ndarray, "*n"]) -> float:
    """PSNR of squared differences; at most 100 dB, which equal pictures have. NaN of none."""
    return float(-10 * np.log10(max(float(squares.mean()), 1e-10))) if squares.size else math.nan


def _overlap(picture, alpha) -> float | None:
    if alpha is None:
        return None
    one, other = picture[..., 3] > 0.5, alpha > 0.5
    return float((one & other).sum() / max((one | other).sum(), 1))


def require_skimage():
    """scikit-image's function for SSIM. Raises ImportError, which says how to install the package."""
    try:
        from skimage.metrics import structural_similarity
    except ImportError as missing:
        raise ImportError('SSIM needs scikit-image, which is optional: pip install -e ".[reconstruct]"') from missing
    return structural_similarity
