"""The size of programs, and the time of each stage from `import jaxdr` to a gradient."""

import statistics
import time

from experiments import common
from experiments.compilation import scenes, trees

CALLS = 7
JITS = ("jax.jit", "jd.jit")
SPP, TARGET_SPP = 16, 64  # README's
COLUMNS = {
    "case": ("case", ""),
    "jaxdr": ("tree", ""),
    "operations": ("operations", ",d"),
    "equations": ("equations", ",d"),
    "closest hits": ("closest_hit", "d"),
    "occlusion": ("occluded", "d"),
    "import": ("import", ".1f"),
    "scene": ("scene", ".1f"),
    "first image": ("image", ".1f"),
    "tracing": ("jd.jit trace", ".1f"),
    "lowering": ("jd.jit lower", ".1f"),
    "compiling, jax.jit": ("jax.jit compile", ".1f"),
    "jd.jit": ("jd.jit compile", ".1f"),
    "first gradient, jax.jit": ("jax.jit first", ".1f"),
    "by jd.jit": ("jd.jit first", ".1f"),
    "a gradient, jax.jit": ("jax.jit again", ".3f"),
    "a gradient, jd.jit": ("jd.jit again", ".3f"),
}


def program(tree, name: str, jit: str, compiled: bool, size: int) -> dict:
    """Sizes and seconds of one case's gradient by one of the two `jit`; a process of its own, without any cache.

    Without `compiled`, nothing behind lowering.
    """
    trees.use(tree)
    import jax
    import jax.numpy as jnp

    import jaxdr as jd
    from experiments import program_size

    jax.config.update("jax_enable_compilation_cache", False)
    start = time.perf_counter()
    scene, integrator = scenes.built(name, size)
    jax.block_until_ready(jax.tree.leaves(scene))
    seconds = {"scene": time.perf_counter() - start}
    target = jnp.zeros((size, size, 3))
    if compiled:
        image = jax.jit(lambda key: jd.render(scene, key, TARGET_SPP, integrator))
        target, seconds["image"] = common.seconds_of(image, jax.random.key(0))

    gradient = (jax.jit if jit == "jax.jit" else jd.jit)(jax.grad(scenes.loss_of(scene, integrator, SPP, target)))
    offset, key = jnp.array([0.1, 0.0, 0.0]), jax.random.key(1)
    traced, seconds["trace"] = _timed(lambda: gradient.trace(offset, key))
    lowered, seconds["lower"] = _timed(traced.lower)
    text = lowered.as_text()
    sizes = {
        "equations": sum(1 for _ in program_size.equations(traced.jaxpr.jaxpr)),
        "operations": program_size.operations(text),
        "closest_hit": program_size.call_sites(text, "closest_hit"),
        "occluded": program_size.call_sites(text, "occluded"),
    }
    if compiled:
        run, seconds["compile"] = _timed(lowered.compile)
        _, once = common.seconds_of(run, offset, key)
        seconds["first"] = seconds["trace"] + seconds["lower"] + seconds["compile"] + once
        calls = [common.seconds_of(run, offset, jax.random.key(2 + i))[1] for i in range(CALLS)]
        seconds["again"] = statistics.median(calls)
    return {"sizes": sizes, "seconds": seconds}


def _timed(stage):
    start = time.perf_counter()
    answer = stage()
    return answer, time.perf_counter() - start


def row(label: str, tree, name: str, jits, compiled: bool, size: int) -> dict:
    """A case's row: each `jit` in a fresh process; of what they share, the process of the first."""
    found = {"case": name, "tree": label}
    if compiled:
        found["import"] = trees.import_seconds(tree)
    for jit in jits if compiled else JITS[1:]:
        made = common.in_fresh_process(program, tree, name, jit, compiled, size)
        found = made["sizes"] | {k: v for k, v in made["seconds"].items() if k in ("scene", "image")} | found
        found |= {f"{jit} {stage}": taken for stage, taken in made["seconds"].items()}
    return found


def main(options, versions: dict) -> str:
    """Measure, keep and return the tables; the versions take turns at every case."""
    folder, rows = common.results("compilation", options.quick), []
    lines = {label: trees.lines_of_code(tree) for label, tree in versions.items()}
    size = 16 if options.quick else 128
    for name in options.case or (["README, depth 2"] if options.quick else scenes.CASES):
        for label, tree in versions.items():
            rows.append(row(label, tree, name, options.jit or JITS, not options.no_compile, size))
            print(common.table(rows[-1:], COLUMNS).splitlines()[-1], flush=True)
            common.write_json(folder / "size.json", {"rows": rows, "lines": lines, "size": size, "spp": SPP})
    rooms = sorted({room for counts in lines.values() for room in counts} - {"sum"})
    counted = [{"room": room} | {label: c.get(room, 0) for label, c in lines.items()} for room in [*rooms, "sum"]]
    return "\n\n".join(
        [common.table(rows, COLUMNS), common.table(counted, {"room": ("room", "")} | {k: (k, ",d") for k in lines})]
    )
