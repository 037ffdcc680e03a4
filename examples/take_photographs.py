"""Take photographs: a folder of pictures, masks and cameras in the layout of instant-ngp.

The folder is the argument, or `photographs`. Put your own photographs in its place.
"""

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

import jaxdr as jd

PIXELS, SAMPLES, PHOTOGRAPHS, FOV = 128, 64, 24, 30.0
SPOT = Path(__file__).resolve().parents[1] / "experiments/data/spot_low.obj"  # by Keenan Crane, in the public domain
Z_UP = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])  # of meshes and skies that have y up


def make_scene(pixels: int) -> jd.Scene:
    """Spot the cow, with brown patches, under a sky that is brighter above."""
    spot = jd.shapes.centred(jd.shapes.transformed(jd.load_mesh(SPOT), Z_UP), 1.1)
    mesh = jd.Mesh(*trimesh.remesh.subdivide_loop(np.asarray(spot.vertices), np.asarray(spot.faces), 2))
    x, y, z = np.asarray(mesh.vertices).T
    patches = np.sin(11 * x + 4 * z) + np.sin(12 * y + 1) + np.sin(10 * z - 6 * x) > 0.7
    paint = np.where(patches[:, None], (0.85, 0.75, 0.6), (0.3, 0.11, 0.04))
    painted = jd.Shape(mesh, jd.Diffuse(jd.VertexColors(paint)))
    height = np.linspace(1, 0, 16)[:, None, None]  # rows of the sky, from the zenith down
    sky = jd.EnvironmentMap(np.broadcast_to((0.3, 0.34, 0.4) + (0.65, 0.6, 0.5) * height, (16, 32, 3)), Z_UP)
    film = jd.Film(pixels, pixels, jd.Box())  # a sensor sums up the light of each pixel's own square
    return jd.Scene({"object": painted}, jd.Perspective(np.eye(4), FOV, film), sky)


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
    def expose(pose, key):  # the picture [H, W, 3], and where the object is [H, W]
        placed = scene.replace({"camera.to_world": pose})
        return jd.render(placed, key, samples), jd.render_aovs(placed, key, names=["shape"])["shape"] >= 0

    for i, pose in enumerate(poses(count)):
        picture, inside = expose(pose, jax.random.key(i))
        jd.write_image(f"{folder}/images/{i:02d}.png", picture)
        jd.write_image(f"{folder}/masks/{i:02d}.png", jnp.where(inside[..., None], jnp.ones(3), 0.0))
        # jaxdr's cameras have x to the left and look along +z; those of instant-ngp x to the right, along -z.
        matrix = np.asarray(pose) @ np.diag([-1.0, 1.0, -1.0, 1.0])
        frames.append({"file_path": f"images/{i:02d}.png", "transform_matrix": matrix.tolist()})
    cameras = json.dumps({"camera_angle_x": np.radians(FOV), "frames": frames}, indent=1)
    (Path(folder) / "transforms.json").write_text(cameras)


if __name__ == "__main__":
    with jd.working("taking photographs"):
        main(*sys.argv[1:])
