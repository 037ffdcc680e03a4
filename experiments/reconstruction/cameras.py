"""How wrong cameras are: by how much points of the object are seen in other directions than by the true cameras."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

REACH = 0.4  # from the middle of the object; its longest side is about one


def camera_errors(true: Path, found: Path) -> dict[str, float]:
    """Root mean square of the error over cameras and points (degrees), of two files of instant-ngp's layout.

    `rms` as they are; `rms_aligned` after the best common motion and scale of all found cameras: that part is not in
    the photographs. Cameras of the files belong together by the names of their pictures. Those of a result (`to_asset`)
    are taken back to the world of the given cameras.
    """
    pairs = pairs_of_poses(true, found)
    points = REACH * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])

    def errors(motion: np.ndarray) -> np.ndarray:
        moved = np.exp(motion[6]) * points @ Rotation.from_rotvec(motion[:3]).as_matrix().T + motion[3:6]
        return np.concatenate([(_seen(points, one) - _seen(moved, other)).ravel() for one, other in pairs])

    start = np.zeros(7)
    # Worlds of cameras that were found from photographs alone have nothing in common with the true one.
    motion = alignment(pairs)
    size = np.cbrt(np.linalg.det(motion[:3, :3]))
    back = Rotation.from_matrix(motion[:3, :3] / size).inv()
    near = np.concatenate([back.as_rotvec(), -back.apply(motion[:3, 3]) / size, [-np.log(size)]])
    aligned = min((least_squares(errors, each).fun for each in (start, near)), key=lambda found: (found**2).sum())
    return {"rms": _degrees(errors(start)), "rms_aligned": _degrees(aligned)}


def pairs_of_poses(true: Path, found: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """(true, found) poses of the same pictures: same name and folder, or same name if only one picture has it."""
    truth = _poses(true)
    stems = [name.split("/")[-1] for name in truth]
    alone = {name.split("/")[-1]: pose for name, pose in truth.items() if stems.count(name.split("/")[-1]) == 1}
    both = [(truth.get(name, alone.get(name.split("/")[-1])), pose) for name, pose in _poses(found).items()]
    return [(one, other) for one, other in both if one is not None]


def alignment(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """The similarity (4 x 4) from the found to the true world that brings the centres of cameras closest (Umeyama).

    Raises ValueError for fewer than three cameras.
    """
    if len(pairs) < 3:
        raise ValueError(f"{len(pairs)} cameras have a true one; an alignment needs three")
    true, found = np.array([one[:3, 3] for one, _ in pairs]), np.array([other[:3, 3] for _, other in pairs])
    to, of = true - true.mean(0), found - found.mean(0)
    u, stretch, v = np.linalg.svd(to.T @ of)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])  # no mirror
    motion = np.eye(4)
    motion[:3, :3] = (stretch * signs).sum() / (of**2).sum() * (u * signs) @ v
    motion[:3, 3] = true.mean(0) - motion[:3, :3] @ found.mean(0)
    return motion


def _poses(path: Path) -> dict[str, np.ndarray]:
    table = json.loads(path.read_text())
    back = np.linalg.inv(np.array(table.get("to_asset", np.eye(4))))
    poses = {"/".join(Path(f["file_path"]).with_suffix("").parts[-2:]): f["transform_matrix"] for f in table["frames"]}
    return {name: unit_axes(back @ np.array(pose)) for name, pose in poses.items()}


def unit_axes(pose: np.ndarray) -> np.ndarray:
    """A pose whose axes are unit vectors again."""
    return np.concatenate([pose[:, :3] / np.cbrt(np.linalg.det(pose[:3, :3])), pose[:, 3:]], 1)


def _seen(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    return local[:, :2] / local[:, 2:]


def _degrees(errors: np.ndarray) -> float:
    return float(np.degrees(np.sqrt((errors.reshape(-1, 2) ** 2).sum(1).mean())))
