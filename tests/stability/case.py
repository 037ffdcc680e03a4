"""What a case of the stability table is, and which estimators it is measured with."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd

# The columns of the table. RednerWAS as its own documentation asks for it: emitter samples alone, and the distance
# function that has a small scale (with the other, Eq. 57, half of every derivative is missing).
ESTIMATORS = {
    "none": (None, "mis"),
    "KernelDensity": (jd.KernelDensity(), "mis"),
    "LineSampling": (jd.LineSampling(), "mis"),
    "WarpedArea": (jd.WarpedArea(), "mis"),
    "RednerWAS": (jd.RednerWAS("path_space", sigma0=0.03), "emitter"),
    "GuidedEdges": (jd.GuidedEdges(), "mis"),
    "AllSilhouettes": (jd.AllSilhouettes(), "mis"),
    "QuadricSampling": (jd.QuadricSampling(), "mis"),
    "MarkovChains": (jd.MarkovChains(), "mis"),
    "WalkOnCaps": (jd.WalkOnCaps(), "emitter"),
    # The default where surfaces are glossy, and options that some cases are about.
    "ByKind": (jd.ByKind(), "mis"),
    "KernelDensity, radius 0.2": (jd.KernelDensity(0.2), "mis"),
    "RednerWAS, exponential": (jd.RednerWAS(), "emitter"),
    "RednerWAS, no normal edges": (jd.RednerWAS("path_space", False, 0.03), "emitter"),
}
COLUMNS = tuple(ESTIMATORS)[1:10]


def integrator(estimator: str, max_depth: int):
    """The integrator of a column of the table."""
    boundary, sampling = ESTIMATORS[estimator]
    return jd.PathTracer(max_depth, boundary, sampling=sampling)


@dataclass(frozen=True)
class Expected:
    """What is known to happen instead of a right derivative: the verdict, and why."""

    verdict: str
    why: str


DIRECT_ONLY = Expected("refuses", "direct light")


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, and one number t that moves it: every parameter in `moves` is its value + t · its velocity.

    - `source`: where the failure is known from.
    - `step`: the reference is (I(step) - I(-step)) / (2 step), common random numbers, `batches` of
      `reference_spp` samples per pixel.
    - `spp`, `calls`: of an estimator.
    - `tolerance`: of the bias and of the projection, apart from three standard errors.
    - `spread`: largest standard deviation of one call at `spp`, relative to the reference's root mean square.
    - `expected`: by estimator, where it is not `right`.
    - `boundary`: whether visibility changes; where not, the interior term alone has to be right as well.
    - `extra`: estimators beside the columns of the table; `only`: estimators in place of them.
    """

    name: str
    theme: str
    about: str
    source: str
    made: jd.Scene | Callable[[], jd.Scene]  # a function where it takes long
    moves: Mapping[str, Any]
    step: float
    max_depth: int = 2
    reference_spp: int = 256
    batches: int = 32
    spp: int = 16
    calls: int = 32
    tolerance: float = 0.03
    spread: float | Mapping[str, float] = 3.0
    expected: Mapping[str, Expected] = field(default_factory=dict)
    boundary: bool = True
    extra: tuple[str, ...] = ()
    only: tuple[str, ...] = ()

    @cached_property
    def scene(self) -> jd.Scene:
        """At t = 0."""
        return self.made if isinstance(self.made, jd.Scene) else self.made()

    def estimators(self) -> tuple[str, ...]:
        """Of this case's row."""
        chosen = self.only or COLUMNS
        return (*(() if self.boundary else ("none",)), *chosen, *self.extra)

    def velocities(self) -> dict[str, jax.Array]:
        """By parameter, with the parameter's shape."""
        parameters = self.scene.parameters()
        return {
            name: jnp.asarray(np.broadcast_to(velocity, parameters[name].shape), parameters[name].dtype)
            for name, velocity in self.moves.items()
        }

    def largest_spread(self, estimator: str) -> float:
        """The bound of an estimator; that of "" where it has none of its own."""
        if isinstance(self.spread, Mapping):
            return self.spread.get(estimator, self.spread[""])
        return self.spread

    def digest(self) -> str:
        """Of everything that the reference depends on. Edges follow from faces; what order they have doesn't matter."""
        found = hashlib.sha256()
        for path, leaf in jax.tree_util.tree_leaves_with_path((self.scene, self.velocities())):
            if ".edges." in jax.tree_util.keystr(path):
                continue
            # Moments, not bits: the last bit differs between processors.
            values = np.asarray(leaf).astype(np.float64).ravel()
            size = np.abs(values).sum()
            moments = values.sum(), (values * np.cos(np.arange(values.size))).sum(), (values**2).sum() ** 0.5
            shares = [round(float(moment / (size or 1.0)), 4) + 0.0 for moment in moments]
            found.update(repr((np.shape(leaf), f"{size:.4e}", shares)).encode())
        film = self.scene.camera.film
        found.update(repr((film, self.step, self.max_depth, self.reference_spp, self.batches)).encode())
        return found.hexdigest()[:16]

    def fingerprint(self, estimator: str) -> str:
        """Of everything that a cell depends on beside the library."""
        return f"{self.digest()} {integrator(estimator, self.max_depth)!r} {self.spp} x {self.calls}"
