"""Small folders of photographs: a disc in front of cameras on a circle, z up, as NeRF's scenes and COLMAP have them."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from jaxdr.scene.camera import look_at

SIZE, FOV = 16, 40.0
FOCAL = 0.5 * SIZE / np.tan(np.radians(FOV) / 2)


def poses(count: int) -> list[np.ndarray]:
    """Camera to world (left, up, forward) of cameras that look at the origin."""
    angles = 2 * np.pi * np.arange(count) / count
    return [look_at((2.2 * np.cos(a), 2.2 * np.sin(a), 0.6), (0, 0, 0), (0, 0, 1)) for a in angles]


def disc(size: int = SIZE) -> np.ndarray:
    """Where the object is."""
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    return np.hypot(x - size / 2, y - size / 2) < size / 3


def write_picture(path: Path, size: int = SIZE, alpha: bool = True, grey: int = 128) -> None:
    """A grey picture, with the disc as its alpha or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((size, size, 4 if alpha else 3), grey, np.uint8)
    if alpha:
        pixels[..., 3] = 255 * disc(size)
    Image.fromarray(pixels).save(path)


def write_nerf(folder: Path, train: int = 4, test: int = 2, alpha: bool = True) -> Path:
    """A NeRF synthetic scene."""
    for split, count in (("train", train), ("test", test)):
        frames = []
        for i, pose in enumerate(poses(count)):
            write_picture(folder / split / f"r_{i}.png", alpha=alpha)
            matrix = pose @ np.diag([-1.0, 1, -1, 1])
            frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": matrix.tolist()})
        if count:
            write_json(folder / f"transforms_{split}.json", {"camera_angle_x": np.radians(FOV), "frames": frames})
    return folder


def tell_apart(folder: Path) -> Path:
    """Make every picture of a folder, but not its masks, one that no other one is: to mix them up is seen."""
    paths = sorted(path for path in folder.rglob("*.png") if "masks" not in path.parts)
    for i, path in enumerate(paths):
        pixels = np.array(Image.open(path))
        shade = np.linspace(40 + 10 * i, 200, pixels.shape[1]).astype(np.uint8)
        pixels[..., i % 3] = shade if i % 2 else shade[:, None]
        Image.fromarray(pixels).save(path)
    return folder


def write_json(path: Path, document) -> None:
    """A JSON file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))


def edit_json(path: Path, change) -> None:
    """Apply `change` to the document in a file."""
    document = json.loads(path.read_text())
    change(document)
    write_json(path, document)


def write_colmap(folder: Path, count: int = 3, test: int = 1, model: str = "PINHOLE", masks: bool = True) -> Path:
    """A COLMAP text model with masks."""
    lens = {
        "PINHOLE": f"{FOCAL} {FOCAL} 8 8",
        "SIMPLE_PINHOLE": f"{FOCAL} 8 8",
        "OPENCV": f"{FOCAL} {FOCAL} 8 8 .1 0 0 0",
    }
    place = folder / "sparse" / "0"
    place.mkdir(parents=True)
    (place / "cameras.txt").write_text(f"1 {model} {SIZE} {SIZE} {lens[model]}\n")
    (place / "points3D.txt").write_text("# empty\n")
    lines = []
    for i, pose in enumerate(poses(count)):
        name = f"test_{i}.png" if i >= count - test else f"train_{i}.png"
        write_picture(folder / "images" / name, alpha=False)
        if masks:
            (folder / "masks").mkdir(exist_ok=True)
            Image.fromarray((255 * disc()).astype(np.uint8)).save(folder / "masks" / name)
        world = np.linalg.inv(pose @ np.diag([-1.0, -1, 1, 1]))
        values = (*quaternion(world[:3, :3]), *world[:3, 3])
        lines.append(f"{i + 1} " + " ".join(f"{x:.12f}" for x in values) + f" 1 {name}\n\n")
    (place / "images.txt").write_text("".join(lines))
    return folder


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation."""
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(rotation).as_quat(), 1)
