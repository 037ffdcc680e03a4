"""Derivative images of the reference scenes by versions of jaxdr: do they agree, and what is error² · seconds?"""

import statistics

import numpy as np

from experiments import common
from experiments.compilation import trees
from experiments.reference_scenes import SCENES, load

ESTIMATORS = ("KernelDensity", "LineSampling", "GuidedEdges")
SPP, KEYS = {"cornell_indirect": 64}, 16
COLUMNS = {
    "scene": ("scene", ""),
    "estimator": ("estimator", ""),
    "jaxdr": ("tree", ""),
    "projection": ("projection", ".4f"),
    "its error": ("deviation", ".4f"),
    "error²": ("squared", ".3e"),
    "seconds": ("seconds", ".3f"),
    "error² · s": ("product", ".3e"),
}


def estimate(tree, folder, name: str, estimator: str, spp: int, keys: int) -> dict:
    """Derivative images of `keys` calls and the median of their seconds; a process of its own.

    `projection` on the reference with the standard error of its mean; `squared`: the mean square of a call's noise over
    that of the reference.
    """
    trees.use(tree)
    import jax

    import jaxdr as jd

    reference = load(folder / name)
    derivative = reference.derivative(
        jd.PathTracer(max_depth=reference.max_depth, boundary=getattr(jd, estimator)()), spp
    )
    jax.block_until_ready(derivative(jax.random.key(0)))
    calls = [common.seconds_of(derivative, jax.random.key(1 + i)) for i in range(keys)]
    images, seconds = np.stack([np.asarray(image, float) for image, _ in calls]), [s for _, s in calls]
    size = (reference.image**2).sum()
    projections = (images * reference.image).sum((1, 2, 3)) / size
    found = {"projection": projections.mean(), "deviation": projections.std(ddof=1) / keys**0.5}
    found |= {"squared": images.var(0, ddof=1).sum() / size, "seconds": statistics.median(seconds)}
    return {name: float(value) for name, value in found.items()}


def main(options, versions: dict) -> str:
    """Measure, keep and return the table; the versions take turns at every scene and estimator."""
    folder, rows = common.results("compilation", options.quick), []
    for name in options.scene or SCENES:
        for estimator in ESTIMATORS:
            for label, tree in versions.items():
                spp, keys = (1, 2) if options.quick else (SPP.get(name, 16), KEYS)
                found = common.in_fresh_process(estimate, tree, options.oracle, name, estimator, spp, keys)
                found["product"] = found["squared"] * found["seconds"]
                rows.append({"scene": name, "estimator": estimator, "tree": label, "spp": spp} | found)
                print(common.table(rows[-1:], COLUMNS).splitlines()[-1], flush=True)
                common.write_json(folder / "oracles.json", {"rows": rows, "keys": KEYS})
    return common.table(rows, COLUMNS)
