"""The gradient of README's scene by `jaxdr.torch`, beside that of JAX: whether they are equal, and seconds in turns.

    python -m experiments.pytorch.run

It needs the extra `torch`. The loss is the same in both: mean squares of the image against a target. Keys change in
each round, and are the same on both sides.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import torch

import jaxdr as jd
import jaxdr.torch
from experiments.compilation.scenes import MOVING, scene_of

ROUNDS = 9


def main() -> None:
    """Prints a table: value and gradient of both, and seconds."""
    scene = scene_of("plain", jd.Film(128, 128))
    target = jd.render(scene, jax.random.key(0), spp=64)
    vertices = scene.parameters()[MOVING] + jnp.array([0.1, 0.0, 0.0])

    def loss(x, key):
        return jd.losses.l2(jd.render(scene.replace({MOVING: x}), key, spp=16), target)

    in_jax = jd.jit(jax.value_and_grad(loss))
    of_tensors = torch.from_numpy(np.array(vertices)).requires_grad_()
    target_tensor = torch.from_numpy(np.array(target))

    def in_torch(key):
        of_tensors.grad = None
        image = jaxdr.torch.render(scene, {MOVING: of_tensors}, key, spp=16)
        value = torch.mean((image - target_tensor) ** 2)
        value.backward()
        return value.detach(), of_tensors.grad

    seconds: dict[str, list[float]] = {"JAX": [], "PyTorch": []}
    differences = []
    for i in range(ROUNDS + 1):
        key = jax.random.key(i)
        start = time.perf_counter()
        value, gradient = jax.block_until_ready(in_jax(vertices, key))
        middle = time.perf_counter()
        value_torch, gradient_torch = in_torch(key)
        seconds["JAX"].append(middle - start)
        seconds["PyTorch"].append(time.perf_counter() - middle)
        ours, theirs = gradient_torch.numpy(), np.asarray(gradient)
        differences.append(
            (abs(float(value_torch) / float(value) - 1), np.abs(ours - theirs).max() / np.abs(theirs).max())
        )
    print("| | first call, s | median of later ones, s |\n| --- | --- | --- |")
    for name, times in seconds.items():
        print(f"| {name} | {times[0]:.1f} | {np.median(times[1:]):.3f} |")
    ratios = np.array(seconds["PyTorch"][1:]) / np.array(seconds["JAX"][1:])
    print(f"\nPyTorch / JAX, round by round: median {np.median(ratios):.3f} ({ratios.min():.3f} to {ratios.max():.3f})")
    value, gradient = np.max(differences, axis=0)
    print(f"largest difference: value {value:.1e} of it, gradient {gradient:.1e} of its largest component")


if __name__ == "__main__":
    main()
