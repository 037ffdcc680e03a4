"""References and their noise: stored derivative images, central differences, long runs for gradients by vertices."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.chart.config import ChartScene, FiniteDifferences, Stored, Vertices
from jaxdr.chart.measure import Line
from jaxdr.chart.scenes import Case
from jaxdr.compilation import jit
from jaxdr.integrators import PathTracer
from jaxdr.render import render
from jaxdr.untrusted import array_of


def stored_reference(scene: ChartScene, case: Case) -> tuple[Float[np.ndarray, "H W 3"], float]:
    """(image in the file, its noise). Raises ValueError for a file that can't be read or does not fit the scene."""
    source = scene.reference
    assert isinstance(source, Stored)
    place = f"scene {scene.name}: reference.file: {source.file}"
    image = array_of(Path(source.file), place)
    _, _, width, height = case.scene.camera.film.window
    if image.shape != (height, width, 3) or image.dtype.kind != "f":
        raise ValueError(
            f"{place}: expected floats of shape [{height}, {width}, 3], as the scene's film is, "
            f"got {image.dtype} {list(image.shape)}"
        )
    if not np.isfinite(image).all():
        raise ValueError(f"{place}: {int((~np.isfinite(image)).sum())} values are not finite")
    return image.astype(np.float64), source.noise


def difference_batches(scene: ChartScene, case: Case, key: PRNGKeyArray) -> Callable[[int], Float[np.ndarray, "H W 3"]]:
    """Function from the number of a batch to (I(step) - I(-step)) / (2 step), with common random numbers.

    The images are always the path tracer's, whichever integrators are measured. No derivative is taken.
    """
    source = scene.reference
    assert isinstance(source, FiniteDifferences)
    image = _still(case, scene.max_depth, source.samples)

    def batch(number: int):
        own = jax.random.fold_in(key, number)
        ahead, behind = (np.asarray(image(t, own), np.float64) for t in (source.step, -source.step))
        return (ahead - behind) / (2 * source.step)

    return batch


def residual(options: Vertices, scene: ChartScene, case: Case, key: PRNGKeyArray) -> Float[np.ndarray, "H W 3"]:
    """Derivative of half the mean squared difference between the images at rest and at `target`, by the one at rest.

    With `residual` "ones" it is one everywhere: the derivative of the sum.
    """
    if options.residual == "ones":
        _, _, width, height = case.scene.camera.film.window
        return np.ones((height, width, 3), case.rest.dtype)
    image = _still(case, scene.max_depth, options.image_samples)
    one, two = (np.asarray(image(t, jax.random.fold_in(key, i))) for i, t in enumerate((0.0, options.target)))
    return (one - two) / one.size


def vertex_batches(line: Line, options: Vertices, key: PRNGKeyArray) -> Callable[[int], Float[np.ndarray, "V 3"]]:
    """Function from the number of a batch to the reference estimator's gradient by the vertices."""
    program = line.vertices(options.samples)

    def batch(number: int):
        return line.timed(program, 0.0, number, jax.random.fold_in(key, number))[0]

    return batch


def agreement(
    residual: Float[np.ndarray, "H W 3"],
    image: Float[np.ndarray, "H W 3"],
    image_noise: float,
    gradients: Float[np.ndarray, "B V 3"],
    velocity: Float[Array, "V 3"],
) -> dict[str, float]:
    """The derivative of the loss by t in two ways: from the reference image, and from the gradients by vertices.

    The `difference`, with its standard error `error`, checks the reference by vertices, which is itself an estimate.
    The channels of a pixel count as fully correlated, and pixels as independent.
    """
    along = (gradients.astype(np.float64) * np.asarray(velocity, np.float64)).sum((1, 2))
    from_image = float((residual.astype(np.float64) * image).sum())
    noise2 = image_noise**2 * float((np.abs(residual.astype(np.float64)).sum(-1) ** 2).sum())
    return {
        "from_image": from_image,
        "from_vertices": float(along.mean()),
        "difference": float(along.mean()) - from_image,
        "error": float(np.sqrt(noise2 + along.var(ddof=1) / len(along))),
    }


def velocity(case: Case) -> Float[Array, "V 3"]:
    """d vertices / dt at rest."""
    zero = jnp.zeros((), case.rest.dtype)
    return jax.jvp(case.at, (zero,), (jnp.ones_like(zero),))[1]


def _still(case: Case, max_depth: int, spp: int) -> Callable[[Any, PRNGKeyArray], Array]:
    tracer = PathTracer(max_depth=max_depth, boundary=None)
    return jit(lambda t, key: render(case.moved(jnp.asarray(t, case.rest.dtype)), key, spp=spp, integrator=tracer))
