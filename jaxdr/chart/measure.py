"""Compiled programs of a line of the chart, and measurements of them: seconds of a call and to compile, memory."""

import multiprocessing
import platform
import re
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.chart.config import ChartScene, Estimator
from jaxdr.chart.scenes import Case, load_case, nudged
from jaxdr.compilation import jit
from jaxdr.integrators import Integrator
from jaxdr.render import derivative_terms, render

WATERMARK = Path("/proc/self/clear_refs")  # Linux: writing 5 resets the peak of resident memory
STATUS = Path("/proc/self/status")


class Program(NamedTuple):
    """A compiled function of (t, key), the seconds that tracing and compilation took, and bytes of XLA's buffers."""

    call: Callable[..., Any]
    compile_seconds: float
    program_bytes: int | None


class Line:
    """One estimator on one scene: programs for a number of samples per pixel."""

    def __init__(self, case: Case, name: str, integrator: Integrator, residual: Float[np.ndarray, "H W 3"] | None):
        self.case = case
        self.name = name
        self.integrator = integrator
        self.residual = residual
        self.dtype = case.rest.dtype

    def image(self, spp: int) -> Program:
        """Program (t, key) -> derivative image at t."""

        def derivative(t, key):
            def image(t):
                return render(self.case.moved(t), key, spp=spp, integrator=self.integrator)

            return jax.jvp(image, (t,), (jnp.ones_like(t),))[1]

        return compiled(derivative, self._place(0.0), jax.random.key(0))

    def vertices(self, spp: int) -> Program:
        """Program (t, key) -> gradient at t of <residual, image> by the vertices; see `jaxdr.chart.config.Vertices`."""
        residual = jnp.asarray(self.residual, self.dtype)

        def gradient(t, key):
            def image(vertices):
                scene = self.case.scene.replace({self.case.parameter: vertices})
                return render(scene, key, spp=spp, integrator=self.integrator)

            return jax.vjp(image, self.case.at(t))[1](residual)[0]

        return compiled(gradient, self._place(0.0), jax.random.key(0))

    def terms(self, spp: int) -> Program:
        """Program (t, key) -> derivative image of each term, by name."""

        def derivative(t, key):
            def images(t):
                moving = self.case.moving
                return derivative_terms(self.case.moved(t), key, spp=spp, integrator=self.integrator, moving=moving)

            return jax.jvp(images, (t,), (jnp.ones_like(t),))[1]

        return compiled(derivative, self._place(0.0), jax.random.key(0))

    def timed(self, program: Program, t: float, number: int, key: Array) -> tuple[Any, float]:
        """(arrays on the host, seconds) of call `number`. The time includes building acceleration structures."""
        place = jax.block_until_ready(self._place(nudged(self.case, t, number)))
        start = time.perf_counter()
        answer = jax.block_until_ready(program.call(place, key))
        seconds = time.perf_counter() - start
        return jax.tree.map(np.asarray, answer), seconds

    def _place(self, t: float):
        return jnp.asarray(t, self.dtype)


def compiled(function: Callable, *arguments) -> Program:
    """The program of a function for these arguments. It is compiled ahead of time, so that this is timed separately."""
    start = time.perf_counter()
    program = jit(function).lower(*arguments).compile()
    seconds = time.perf_counter() - start
    analysis = program.memory_analysis()
    size = None
    if analysis is not None:
        size = int(analysis.temp_size_in_bytes + analysis.output_size_in_bytes + analysis.argument_size_in_bytes)
    return Program(program, seconds, size)


def make_line(scene: ChartScene, estimator: Estimator, case: Case, residual=None) -> Line:
    """The line of an estimator on a scene."""
    return Line(case, estimator.name, estimator.build(scene.max_depth), residual)


def in_fresh_process(function: Callable, *arguments) -> Any:
    """`function(*arguments)` in a new interpreter, which inherits no cache, no thread pool and no peak of memory."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def peak_memory(scene: ChartScene, estimator: Estimator, spp: int) -> dict:
    """Peak resident memory (bytes) of this process while it computes derivative images. To be run in a fresh process.

    `compilation` says whether the peak may be that of compiling: not every operating system can reset the peak.
    """
    case = load_case(scene.name, scene.file, scene.procedural, scene.options, scene.motion)
    line = make_line(scene, estimator, case)
    program = line.image(spp)
    fresh = _restart_watermark()
    for number in range(2):
        line.timed(program, 0.0, number, jax.random.key(number))
    return {"peak_bytes": _watermark(), "compilation": not fresh}


def _restart_watermark() -> bool:
    try:
        WATERMARK.write_text("5")
    except OSError:
        return False
    return STATUS.exists()


def _watermark() -> int:
    if STATUS.exists():
        found = re.search(r"VmHWM:\s*(\d+) kB", STATUS.read_text())
        if found:
            return 1024 * int(found[1])
    unit = 1 if platform.system() == "Darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def predicted(history: list[tuple[int, float]], spp: int) -> float:
    """Estimated seconds of a call with `spp` samples, from (samples, seconds) of calls with fewer.

    It is on the line through the last two points. From a single point it is the time of that point: a call with more
    samples won't take less.
    """
    if len(history) < 2:
        return history[-1][1] if history else 0.0
    (n0, t0), (n1, t1) = history[-2:]
    return t1 + max(0.0, (t1 - t0) / (n1 - n0)) * (spp - n1)
