"""The effect of compiler options: seconds to compile and to run, of `jaxdr.jit` against `jax.jit`.

Both programs of a case are called in turns. Acceleration structures are built before, and are not in the times.
"""

import statistics
import time

import numpy as np

from experiments import common
from experiments.reference_scenes import load

CALLS = 9
# scene, integrator, boundary estimator, samples per pixel, derivative or image
CASES = (
    ("direct_spot", "PathTracer", "LineSampling", 64, False),
    ("direct_spot", "PathTracer", "LineSampling", 8, True),
    ("direct_spot", "PathTracer", "KernelDensity", 8, True),
    ("cornell_indirect", "PathTracer", "LineSampling", 16, False),
    ("cornell_indirect", "PathTracer", "LineSampling", 4, True),
    ("cornell_indirect", "BidirectionalPathTracer", "KernelDensity", 1, True),
)
COLUMNS = {
    "case": ("case", ""),
    "compile (s), jax.jit": ("compile", ".1f"),
    "compile (s), jaxdr.jit": ("compile_options", ".1f"),
    "run (s), jax.jit": ("run", ".3f"),
    "run (s), jaxdr.jit": ("run_options", ".3f"),
    "run, ratio": ("ratio", ".2f"),
}


def measure(folder, scene, integrator, boundary, spp, derivative, calls):
    """One row."""
    import jax

    import jaxdr as jd

    reference = load(folder / scene)
    tracer = getattr(jd, integrator)(reference.max_depth, boundary=getattr(jd, boundary)())

    def image(v, key):
        return jd.render(reference.scene.replace({f"{reference.shape}.vertices": v}), key, spp, tracer)

    def slope(v, key):
        return jax.jvp(lambda v: image(v, key), (v,), (reference.direction,))[1]

    programs, compile_seconds = [], []
    for jit in (jax.jit, jd.jit):
        start = time.perf_counter()
        made = jit(slope if derivative else image)
        programs.append(made.lower(reference.vertices, jax.random.key(0)).compile())
        compile_seconds.append(time.perf_counter() - start)
        jax.block_until_ready(programs[-1](reference.vertices, jax.random.key(0)))
    seconds, answers = ([], []), ([], [])
    for call in range(calls):
        for i, program in enumerate(programs):
            answer, taken = common.seconds_of(program, reference.vertices, jax.random.key(1 + call))
            seconds[i].append(taken)
            answers[i].append(np.asarray(answer, float))
    ours, theirs = (np.mean(a, 0) for a in answers)
    if not np.allclose(ours, theirs, rtol=1e-3, atol=1e-3 * np.abs(theirs).max()):
        print(f"  {scene}, {boundary}: answers differ by up to {np.abs(ours - theirs).max():.3g}")
    run, run_options = (statistics.median(s) for s in seconds)
    what = f"derivative by {boundary}" if derivative else "image"
    return {
        "case": f"{scene}, {integrator}, {what}, {spp} spp",
        "compile": compile_seconds[0],
        "compile_options": compile_seconds[1],
        "run": run,
        "run_options": run_options,
        "ratio": run_options / run,
    }


def main(options, versions: dict) -> str:
    """Measure, keep and return the table, of this version alone."""
    folder, rows = common.results("compilation", options.quick), []
    for case in CASES[:1] if options.quick else CASES:
        rows.append(common.in_fresh_process(measure, options.oracle, *case, 3 if options.quick else CALLS))
        print(rows[-1], flush=True)
        common.write_json(folder / "compilation.json", {"rows": rows})
    return common.table(rows, COLUMNS)
