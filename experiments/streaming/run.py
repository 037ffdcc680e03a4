"""Peak memory of reading few and many photographs in the way that a reconstruction reads them.

    python -m experiments.streaming.run

Photographs have 512² pixels with alpha: 4 MiB decoded and 1.25 MiB reduced. 64 MiB in all are kept. Each number of
photographs has a process of its own. It loads the folder, looks at every picture once (windows around the object), and
takes the first paint from the pictures. Then it fetches those of 100 steps with three views each, read ahead by
threads.
"""

import io
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

SIZE, STEPS, VIEWS_PER_STEP = 512, 100, 3
KEEP = 1 / 32  # GiB as they are, and as much reduced: less than 50 photographs take, so that those are streamed, too
COUNTS = (50, 500, 2000)


def write_photographs(folder: Path, count: int) -> None:
    """A folder as instant-ngp has it, of cheap pictures: an even ball before nothing, 16 different ones in turns."""
    from jaxdr.scene.camera import look_at

    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    pictures = []
    for i in range(16):
        pixels = np.zeros((SIZE, SIZE, 4), np.uint8)
        pixels[..., i % 3] = np.minimum(255, x / 3 + 5 * i)
        pixels[..., 3] = 255 * (np.hypot(x - SIZE / 2, y - SIZE / 2) < (0.25 + 0.005 * i) * SIZE)
        data = io.BytesIO()
        Image.fromarray(pixels).save(data, format="PNG", compress_level=1)
        pictures.append(data.getvalue())
    frames = []
    for i in range(count):
        angle, height = 2.4 * i, 1.6 * (i + 0.5) / count - 0.8
        eye = 2.2 * np.array([np.cos(angle) * np.sqrt(1 - height**2), np.sin(angle) * np.sqrt(1 - height**2), height])
        matrix = look_at(eye, (0, 0, 0), (0, 0, 1)) @ np.diag([-1.0, 1, -1, 1])
        frames.append({"file_path": f"{i:05d}.png", "transform_matrix": np.round(matrix, 9).tolist()})
        (folder / f"{i:05d}.png").write_bytes(pictures[i % 16])
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))


def measure(folder: Path) -> dict:
    """Peak memory (MiB) of this process before and after reading, and seconds."""
    import jaxdr as jd
    from jaxdr.optimize.problem import views_of_step
    from jaxdr.optimize.reconstruction.paint import seen_colors
    from jaxdr.optimize.reconstruction.photo_set import PhotoSet
    from jaxdr.optimize.reconstruction.pictures import Pose

    mesh = jd.shapes.sphere(3, radius=0.5).smooth()
    mesh.vertex_normals().block_until_ready()
    before, start = peak(), time.monotonic()
    views = jd.load_views(folder, keep=KEEP)
    loaded = time.monotonic() - start
    photos = PhotoSet(views.fitted, [256], int(KEEP * 2**30))
    photos.pose = Pose(np.zeros(3), 1.0)
    colors = seen_colors(mesh, photos.paint())
    photographs, count = photos.at(256), len(views.fitted)
    for step in range(STEPS):
        chosen = [v for s in (step, step + 1) for v in views_of_step(count, VIEWS_PER_STEP, s, 0)]
        photographs.expect(chosen)
        for view in chosen[:VIEWS_PER_STEP]:
            assert np.isfinite(photographs[view].color).all()
    return {
        "photographs": len(views.views),
        "peak_mib_before": before,
        "peak_mib": peak(),
        "seconds_loading": round(loaded, 2),
        "seconds": round(time.monotonic() - start, 1),
        "mean_color": float(colors.mean()),
    }


def peak() -> float:
    """Peak resident memory of this process, in MiB."""
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)


def main() -> None:
    """A row a number of photographs."""
    rows = []
    for count in COUNTS:
        with tempfile.TemporaryDirectory() as folder:
            write_photographs(Path(folder), count)
            command = [sys.executable, "-m", "experiments.streaming.run", folder]
            rows.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
        print(json.dumps(rows[-1]), flush=True)
    results = Path(__file__).parent / "results"
    results.mkdir(exist_ok=True)
    (results / "streaming.json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(measure(Path(sys.argv[1]))))
    else:
        main()
