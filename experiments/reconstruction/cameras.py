"""How wrong cameras are: by how much points of the object are seen in other directions than by the true cameras."""

import json
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

REACH = 0.4  # from the middle of the object; its longest side is about one


def camera_errors(true: Path, found: Path) -> dict[str, float]:
    """Root mean square of the error over cameras and points (degrees), of two files of instant-ngp's layout.

    Those of a result (`to_asset`) are taken back to the world of the given cameras.

    `rms` as they are; `rms_aligned` after the best common motion and scale of all found cameras: that part is not in
    the photographs. Cameras of the files belong together by the names of their pictures.
    """
    truth = _poses(true)
    pairs = [(truth[name], pose) for name, pose in _poses(found).items() if name in truth]
    points = REACH * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])

    def errors(motion: np.ndarray) -> np.ndarray:
        moved = np.exp(motion[6]) * points @ Rotation.from_rotvec(motion[:3]).as_matrix().T + motion[3:6]
        return np.concatenate([(_seen(points, one) - _seen(moved, other)).ravel() for one, other in pairs])

    start = np.zeros(7)
    aligned = least_squares(errors, start).fun
    return {"rms": _degrees(errors(start)), "rms_aligned": _degrees(aligned)}


def _poses(path: Path) -> dict[str, np.ndarray]:
    table = json.loads(path.read_text())
    back = np.linalg.inv(np.array(table.get("to_asset", np.eye(4))))
    poses = {"/".join(Path(f["file_path"]).with_suffix("").parts[-2:]): f["transform_matrix"] for f in table["frames"]}
    return {name: _turned(back @ np.array(pose)) for name, pose in poses.items()}


def _turned(pose: np.ndarray) -> np.ndarray:
    """A pose whose axes are unit vectors again."""
    return np.concatenate([pose[:, :3] / np.cbrt(np.linalg.det(pose[:3, :3])), pose[:, 3:]], 1)


def _seen(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    return local[:, :2] / local[:, 2:]


def _degrees(errors: np.ndarray) -> float:
    return float(np.degrees(np.sqrt((errors.reshape(-1, 2) ** 2).sum(1).mean())))
