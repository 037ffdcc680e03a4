"""A gradient of one key and `vmap` of it over many: python -m experiments.row_kernels.batches [--members 0 8 32]

Prints seconds of the first call and of a later one, by kernels and by XLA. Each row is a process of its own.
"""

import argparse
import subprocess
import sys
import time

import jax
import jax.numpy as jnp

import jaxdr as jd
from experiments.row_kernels.run import scene

SIZE, SPP, CALLS = 32, 16, 5


def measured(members: int, compute: str) -> str:
    """First call and the best of the later ones; `members` 0 is one key without `vmap`."""
    stage = scene(SIZE)
    integrator = jd.PathTracer(max_depth=2, compute=compute)

    def loss(offset, key):
        return jnp.square(jd.render(jd.move(stage, {"ball.translate": offset}), key, SPP, integrator)).mean()

    gradient, key = jax.grad(loss), jax.random.key(0)
    function = jax.jit(jax.vmap(gradient, (None, 0)) if members else gradient)
    keys = jax.random.split(key, members) if members else key
    seconds = []
    for _ in range(CALLS + 1):
        start = time.perf_counter()
        jax.block_until_ready(function(jnp.zeros(3), keys))
        seconds.append(time.perf_counter() - start)
    return f"{seconds[0]:.1f}, {min(seconds[1:]):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--members", type=int, nargs="+", default=[0, 8, 32])
    parser.add_argument("--one", nargs=2, metavar=("MEMBERS", "COMPUTE"), help="a row, in this process")
    given = parser.parse_args()
    if given.one:
        print(measured(int(given.one[0]), given.one[1]))
        return
    print("| members | kernels: first, each | XLA |\n|---|---|---|")
    for members in given.members:
        command = [sys.executable, "-m", "experiments.row_kernels.batches", "--one", str(members)]
        cells = [
            subprocess.run([*command, compute], check=True, capture_output=True, text=True).stdout.splitlines()[-1]
            for compute in ("kernels", "xla")
        ]
        print(f"| {members or 'one key'} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
