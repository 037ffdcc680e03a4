"""Pilot runs measure variance and seconds of the derivative images of all candidates; the best is chosen."""

import statistics
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from jaxdr.compilation import jit
from jaxdr.integrators import Integrator
from jaxdr.moving import Moving
from jaxdr.plan.directions import Direction
from jaxdr.render import derivative_terms
from jaxdr.scene.scene import Scene

FIRST = 4  # samples per pixel in the first round
MOST = 256  # most samples per pixel in the second round
TURNS = 6  # independent calls of every candidate in a round
CLOSE = 2.0  # candidates go on to the second round if their work is at most this times the best
FINALISTS = 2
BETTER = 0.9  # a change is taken if its work is at most this, relative to the candidate without it
COMPILERS = 2  # threads in which XLA compiles, while the next program is traced
LEAST_SECONDS = 1e-4  # shorter times say more about the clock than about the program

Setting = tuple[Any, int]  # integrator, samples per pixel


class Measured(NamedTuple):
    """One setting at `spp` samples per pixel: median `seconds` of a call, `variance` of its image, terms' `shares`."""

    spp: int
    seconds: float
    variance: float
    shares: dict[str, float]

    @property
    def work(self) -> float:
        """Squared error times seconds: the cost, which does not depend on the budget."""
        return self.variance * self.seconds


class Refused(NamedTuple):
    """An estimator refuses the scene, with this message."""

    message: str


Measure = Callable[[dict[str, Setting]], dict[str, Measured | Refused]]
Changes = Callable[[Any, dict[str, float]], dict[str, Any]]  # (integrator, shares) -> changed integrators, by name


class Choice(NamedTuple):
    """The chosen integrator with its `name`, samples per pixel, all measurements (by round), and lines of reasons."""

    name: str
    integrator: Any
    spp: int
    rounds: list[dict[str, Measured | Refused]]
    lines: list[str]


class Pilot:
    """Measures settings on a scene along a direction. The seconds include everything but compilation."""

    def __init__(self, scene: Scene, along: Direction, moving: Moving, key: PRNGKeyArray):
        self.scene, self.along, self.moving, self.key = scene, along, moving, key
        self.nudge = along.nudge()
        # By the integrator's id. The integrator is kept too, so that no other one gets its id.
        self.programs: dict[tuple[int, int], tuple[Integrator, Any]] = {}

    def __call__(self, settings: dict[str, Setting], key: PRNGKeyArray | None = None) -> dict[str, Measured | Refused]:
        """Measure settings, in turns; each turn begins with another one. `key` replaces the pilot's own."""
        key = self.key if key is None else key
        programs, found = self._compiled(settings)
        calls: dict[str, list] = {name: [] for name in programs}
        names = list(programs)
        for turn in range(TURNS + 1):  # the first turn does not count: it is slow for other reasons too
            for i in range(len(names)):
                name = names[(i + turn) % len(names)]
                answer = self._call(programs[name], turn, key)
                if turn > 0:
                    calls[name].append(answer)
        for name, some in calls.items():
            found[name] = measured(settings[name][1], [c[0] for c in some], [c[1] for c in some])
        return {name: found[name] for name in settings}

    def _compiled(self, settings: dict[str, Setting]) -> tuple[dict[str, Any], dict[str, Measured | Refused]]:
        """(programs, refusals) by name. Each integrator is compiled once for each number of samples."""
        refused: dict[str, Measured | Refused] = {}
        compiled: dict[str, Future] = {}
        pool = ThreadPoolExecutor(COMPILERS, "jaxdr plan")
        try:
            for name, (integrator, spp) in settings.items():
                if (id(integrator), spp) in self.programs:
                    continue
                try:
                    compiled[name] = pool.submit(self._lowered(integrator, spp).compile)
                except ValueError as problem:
                    refused[name] = Refused((str(problem).splitlines() or [""])[0])
            for name, program in compiled.items():
                integrator, spp = settings[name]
                self.programs[id(integrator), spp] = integrator, program.result()
        finally:
            pool.shutdown(cancel_futures=True)
        kept = {name: setting for name, setting in settings.items() if name not in refused}
        return {name: self.programs[id(integrator), spp][1] for name, (integrator, spp) in kept.items()}, refused

    def _lowered(self, integrator: Integrator, spp: int):
        def derivative(scene, along, t, key):
            def images(t):
                return derivative_terms(along.at(scene, t), key, spp, integrator, self.moving)

            return jax.jvp(images, (t,), (jnp.ones_like(t),))[1]

        return jit(derivative).lower(self.scene, self.along, jnp.zeros(()), self.key)

    def _call(self, program, turn: int, key: PRNGKeyArray) -> tuple[dict[str, Array], float]:
        # Each turn moves the scene by another tiny step. Acceleration structures are cached by their content, and would
        # not be built otherwise.
        t = jax.block_until_ready(jnp.asarray(self.nudge * (turn + 1)))
        key = jax.random.fold_in(key, turn)
        start = time.perf_counter()
        answer = jax.block_until_ready(program(self.scene, self.along, t, key))
        return answer, time.perf_counter() - start


def measured(spp: int, calls: list[dict[str, Array]], seconds: list[float]) -> Measured:
    """The figures of a setting, from derivative images by term, and seconds, of independent calls."""
    images = {term: np.stack([np.asarray(call[term], np.float64) for call in calls]) for term in calls[0]}
    total = float(sum(images.values()).var(0, ddof=1).mean())  # pyright: ignore[reportAttributeAccessIssue]
    own = {term: float(stack.var(0, ddof=1).mean()) for term, stack in images.items()}
    whole = sum(own.values())
    shares = {term: value / whole if whole > 0 else 0.0 for term, value in own.items()}
    return Measured(spp, max(statistics.median(seconds), LEAST_SECONDS), total, shares)


def choose(
    tried: dict[str, Any], measure: Measure, changes: Changes, budget: float, spp: int | None, ratio: float = 1.0
) -> Choice:
    """The setting of least squared error times seconds, and the samples per pixel that fill the budget.

    `budget`: seconds of one derivative image, which has `ratio` times as many pixels as the pilot's. If `spp` is given,
    it counts instead. The first round has few samples. Candidates close to the best, and `changes` of the best, go on
    to a second round, which has as many samples as the budget allows. Raises ValueError if no candidate is finite.
    """
    first = measure({name: (integrator, spp or FIRST) for name, integrator in tried.items()})
    lines = [f"not possible here: {name} ({m.message})" for name, m in first.items() if isinstance(m, Refused)]
    good = _ranked(first)
    if not good:
        raise ValueError("plan: no estimator can differentiate this scene; " + "; ".join(lines or ["none is finite"]))
    chosen, last = next(iter(good.items()))
    known: dict[str, Any] = {n: tried[n] for n in list(good)[:FINALISTS] if good[n].work <= CLOSE * last.work}
    variants = {f"{chosen}, {change}": made for change, made in changes(tried[chosen], last.shares).items()}
    counts = {name: spp or _fitting(good[name], budget / ratio) for name in known}
    counts |= dict.fromkeys(variants, counts[chosen])
    rounds = [first]
    if len(counts) > 1 or counts[chosen] > last.spp:
        rounds.append(measure({name: ((known | variants)[name], count) for name, count in counts.items()}))
        again = _ranked(rounds[-1])
        chosen, last = next(((n, m) for n, m in again.items() if n in known), (chosen, last))
        change = next((n for n in again if n in variants), None)
        if change is not None and again[change].work <= BETTER * last.work:
            chosen, last = change, again[change]
        lines += [f"tried and not taken: {name}" for name in variants if name != chosen]
    calls = [m for some in rounds for name, m in _ranked(some).items() if name == chosen]
    count = spp or _filling(calls, budget / ratio)
    seconds = _predicted(calls, count) * ratio
    works = {name: m.work for some in rounds for name, m in _ranked(some).items() if name != chosen}
    reference = last.work if last.work > 0 else 1.0
    compared = ", ".join(f"{name} {work / reference:.2g}" for name, work in works.items())
    lines.append(f"estimator: {chosen}; squared error x seconds of the others, relative to it: {compared or 'none'}")
    lines.append(f"variance by term: {', '.join(f'{term} {share:.0%}' for term, share in last.shares.items())}")
    lines.append(f"samples: {count} per pixel, about {seconds:.2g} s a derivative image")
    return Choice(chosen, (tried | variants)[chosen], count, rounds, lines)


def _ranked(found: dict[str, Measured | Refused]) -> dict[str, Measured]:
    """The measurements that are finite, the best first. Of those without noise the fastest is first."""
    good = {name: m for name, m in found.items() if isinstance(m, Measured) and np.isfinite(m.variance)}
    return dict(sorted(good.items(), key=lambda entry: (entry[1].work, entry[1].seconds)))


def _fitting(found: Measured, seconds: float) -> int:
    """Samples for the second round: as many as fit into the seconds, within limits, if time grows in proportion."""
    return int(np.clip(round(found.spp * seconds / found.seconds), FIRST, MOST))


def _line(found: list[Measured]) -> tuple[float, float]:
    """(fixed seconds of a call, seconds per sample): a line through two counts of samples, or a ratio from one."""
    one, two = found[0], found[-1]
    if two.spp > one.spp and two.seconds > one.seconds:
        slope = (two.seconds - one.seconds) / (two.spp - one.spp)
        if one.seconds > slope * one.spp:
            return one.seconds - slope * one.spp, slope
    return 0.0, two.seconds / two.spp


def _filling(found: list[Measured], seconds: float) -> int:
    fixed, each = _line(found)
    return max(1, int((seconds - fixed) / each + 1e-6))


def _predicted(found: list[Measured], spp: int) -> float:
    fixed, each = _line(found)
    return fixed + each * spp
