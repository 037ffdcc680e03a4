"""Seconds of gradients and images against Mitsuba's (LLVM), in turns, in one process for each version of jaxdr."""

import statistics

import numpy as np

from experiments import common
from experiments.compilation import scenes, trees

# what: arguments of our PathTracer and of Mitsuba's integrator; direct light
PAIRS = {
    "interior gradient, prb": ({"boundary": None}, {"type": "prb"}),
    "whole gradient, direct_projective": ({}, {"type": "direct_projective", "guiding": "none"}),
    "image, path": ({"boundary": None}, {"type": "path"}),
}
COLUMNS = {
    "what": ("what", ""),
    "jaxdr": ("tree", ""),
    "jaxdr, s": ("ours", ".3f"),
    "Mitsuba, s": ("theirs", ".3f"),
    "jaxdr, Mpaths/s": ("our_rate", ".2f"),
    "Mitsuba, Mpaths/s": ("their_rate", ".2f"),
    "seconds, jaxdr / Mitsuba": ("ratio", ".2f"),
    "least": ("least", ".2f"),
    "most": ("most", ".2f"),
    "answers, jaxdr / Mitsuba": ("answers", ".3f"),
}


def ball(tree, folder, size: int, spp: int, rounds: int) -> list[dict]:
    """The rows of `PAIRS`: README's scene, a gradient by an offset of all vertices of the ball; a fresh process."""
    trees.use(tree)
    import jax
    import jax.numpy as jnp

    import jaxdr as jd
    from experiments.compilation.peer import Peer

    scene = scenes.scene_of("plain", jd.Film(size, size, jd.Box()))
    peer = Peer(scene, folder)
    turns = {}
    for what, (ours, theirs) in PAIRS.items():
        tracer = jd.PathTracer(max_depth=2, **ours)
        theirs = theirs if "projective" in theirs["type"] else theirs | {"max_depth": 2}
        if what.startswith("image"):
            made = jd.jit(lambda offset, key, tracer=tracer: jd.render(scene, key, spp, tracer))
            turns[what] = made, peer.image, theirs
        else:
            loss = scenes.loss_of(scene, tracer, spp, jnp.zeros((size, size, 3)))
            turns[what] = jd.jit(jax.grad(loss)), peer.gradient, theirs
    pairs, answers = {what: [] for what in PAIRS}, {what: [] for what in PAIRS}
    for i in range(-2, rounds):  # the first two compile and warm up
        for what, (made, call, theirs) in turns.items():
            mine, seconds = common.seconds_of(made, jnp.zeros(3), jax.random.key(2 + i))
            other, their_seconds = call(theirs, spp, 2 + i)
            if i >= 0:
                pairs[what].append((seconds, their_seconds))
                answers[what].append((np.asarray(mine, float).ravel(), other.astype(float).ravel()))
    paths = size * size * spp / 1e6
    return [{"what": what} | _summary(pairs[what], paths) | {"answers": _projection(answers[what])} for what in PAIRS]


def forward(tree, path, case, size: int, spp: int, rounds: int) -> dict:
    """The row of a scene of `experiments.forward_cost`; a fresh process."""
    trees.use(tree)
    from experiments.forward_cost.run import measure  # imports jaxdr

    row, _, _ = measure(path, case, size, spp, rounds, False)
    return _summary(row["pairs"], size * size * spp / 1e6) | {"answers": row["brightness"]}


def _summary(pairs, paths: float) -> dict:
    ratios = [a / b for a, b in pairs]
    ours, theirs = (statistics.median(side) for side in zip(*pairs, strict=True))
    rates = {"our_rate": paths / ours, "their_rate": paths / theirs}
    spread = {"ratio": statistics.median(ratios), "least": min(ratios), "most": max(ratios)}
    return {"ours": ours, "theirs": theirs} | rates | spread | {"pairs": pairs}


def _projection(answers) -> float:
    """Mean of ours projected on the mean of theirs: 1 where they agree."""
    ours, theirs = (np.mean(side, 0) for side in zip(*answers, strict=True))
    return float(ours @ theirs / (theirs @ theirs))


def main(options, versions: dict) -> str:
    """Measure, keep and return the table; the versions take turns at every scene."""
    from experiments.forward_cost.scenes import scenes as forward_scenes

    folder, rows = common.results("compilation", options.quick), []
    work = common.scratch("compilation") / "scenes"
    work.mkdir(exist_ok=True)
    common.in_fresh_process(_write_files, work)

    def keep(label, made):
        rows.append({"tree": label} | made)
        print(common.table(rows[-1:], COLUMNS).splitlines()[-1], flush=True)
        common.write_json(folder / "rates.json", {"rows": rows})

    for label, tree in versions.items():
        size, spp, rounds = (16, 16, 2) if options.quick else (32, 256, 9)
        for made in common.in_fresh_process(ball, tree, work, size, spp, rounds):
            keep(label, made)
    size, spp, rounds = (32, 16, 2) if options.quick else (128, 64, 5)
    for name, case in forward_scenes(size).items():
        path = work / f"{name.replace(' ', '_')}.xml"
        path.write_text(case.xml)
        for label, tree in versions.items():
            keep(
                label,
                {"what": f"image, {name}"} | common.in_fresh_process(forward, tree, path, case, size, spp, rounds),
            )
    order = list(dict.fromkeys(row["what"] for row in rows))
    return common.table(sorted(rows, key=lambda row: order.index(row["what"])), COLUMNS)


def _write_files(folder):
    from experiments.forward_images.files import write_files  # imports jaxdr

    write_files(folder)
