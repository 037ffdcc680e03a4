"""Take photographs: a folder of pictures, masks and cameras, for from_photographs.py and `jaxdr reconstruct`.

It has the layout of instant-ngp. The folder is the argument, or `photographs`. Put your own photographs in its place.
"""

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd

PIXELS, SAMPLES, PHOTOGRAPHS, FOV = 64, 128, 20, 30.0
SKY = (0.6, 0.7, 0.8)  # below 1: a photograph cuts off what is brighter


def make_scene(pixels: int) -> jd.Scene:
    """A duck with a yellow head and a blue body, under an even sky."""
    duck = jd.shapes.centred(jd.shapes.duck(3), 1.1)
    paint = jnp.where(duck.vertices[:, 2:] > 0.15, jnp.array([0.8, 0.6, 0.1]), jnp.array([0.2, 0.4, 0.7]))
    film = jd.Film(pixels, pixels, jd.Box())  # a sensor sums up the light of each pixel's own square
    painted = jd.Shape(duck, jd.Diffuse(jd.VertexColors(paint)))
    return jd.Scene({"object": painted}, jd.Perspective(np.eye(4), FOV, film), jd.ConstantEnvironment(SKY))


def poses(count: int) -> list[np.ndarray]:
    """Camera to world, [4, 4]: on a circle around the object, from above and from below in turns."""
    angles = 2 * np.pi * (np.arange(count) + 0.5) / count
    eyes = [(3 * np.cos(a), 3 * np.sin(a), 1.2 * (-1) ** i) for i, a in enumerate(angles)]
    return [jd.look_at(eye, (0, 0, 0), (0, 0, 1)) for eye in eyes]


def main(folder: str = "photographs", count=PHOTOGRAPHS, pixels=PIXELS, samples=SAMPLES) -> None:
    """Writes images/NAME.png, masks/NAME.png and transforms.json."""
    for name in ("images", "masks"):
        (Path(folder) / name).mkdir(parents=True, exist_ok=True)
    scene, frames = make_scene(pixels), []

    @jax.jit
    def expose(pose, key):
        """The picture [H, W, 3], and where the object is [H, W]."""
        placed = scene.replace({"camera.to_world": pose})
        return jd.render(placed, key, samples), jd.render_aovs(placed, key, names=["shape"])["shape"] >= 0

    for i, pose in enumerate(poses(count)):
        picture, inside = expose(pose, jax.random.key(i))
        jd.write_image(f"{folder}/images/{i:02d}.png", picture)
        jd.write_image(f"{folder}/masks/{i:02d}.png", jnp.where(inside[..., None], jnp.ones(3), 0.0))
        # jaxdr's cameras have x to the left and look along +z; those of instant-ngp x to the right, along -z.
        matrix = np.asarray(pose) @ np.diag([-1.0, 1.0, -1.0, 1.0])
        frames.append({"file_path": f"images/{i:02d}.png", "transform_matrix": matrix.tolist()})
    cameras = {"camera_angle_x": float(np.radians(FOV)), "frames": frames}
    (Path(folder) / "transforms.json").write_text(json.dumps(cameras, indent=1))


if __name__ == "__main__":
    main(*sys.argv[1:])
