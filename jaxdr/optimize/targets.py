"""The target views of a run: rendered or given, checked, and kept for when it is resumed."""

from collections.abc import Callable, Iterable, Iterator

import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.optimize.output import RunFolder
from jaxdr.optimize.progress import Interrupted, Interruption, NotFinite, Progress


def target_views(
    folder: RunFolder, images: Iterable[Float[np.ndarray | Array, "H W 3"]], level: int | None = None
) -> Float[np.ndarray, "N H W 3"]:
    """`images`, which are then kept in the run's folder; for a resumed run, the images that were kept.

    They are asked for one by one (see `rendered`). `level`: number of a level with images of its own. Raises
    `NotFinite`.
    """
    if folder.targets(level).exists():
        return folder.load_targets(level)
    targets = []
    for i, image in enumerate(images):
        targets.append(np.asarray(image))
        if not np.isfinite(targets[-1]).all():
            raise NotFinite(f"the target image of view {i} is not finite")
    folder.save_targets(np.stack(targets), level)
    return np.stack(targets)


def rendered(
    image: Callable[[Array, PRNGKeyArray], Array],
    poses: Float[Array, "N 4 4"],
    key: PRNGKeyArray,
    interruption: Interruption,
    quiet: bool = False,
) -> Iterator[Array]:
    """`image` of every pose, a key each, with progress unless `quiet`. Raises `Interrupted` after Ctrl-C."""
    with Progress("render targets", len(poses), quiet=quiet) as progress:
        progress.preparing("compiling")
        for i, pose in enumerate(poses):
            yield image(pose, jax.random.fold_in(key, i))
            progress.step()
            if interruption.requested:
                raise Interrupted("stopped while rendering the target views, which will be rendered again")
