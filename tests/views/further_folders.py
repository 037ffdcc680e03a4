"""Small folders of photographs in further layouts: the cameras of `folders`, with an off-centre principal point."""

from pathlib import Path

import numpy as np
from PIL import Image

from tests.views.folders import SIZE, disc, poses, write_picture

F, CENTRE = 21.0, (7.0, 9.5)
K = np.array([[F, 0, CENTRE[0]], [0, F, CENTRE[1]], [0, 0, 1]])
# From world to camera, with x to the right, y down, z forward.
LEFT_UP = np.diag([-1.0, -1, 1, 1])
POINT = np.array([0.21, -0.13, 0.3])


def world_to_camera(pose: np.ndarray) -> np.ndarray:
    """A matrix [3, 4] to x to the right, y down, z forward."""
    return np.linalg.inv(pose @ LEFT_UP)[:3]


def write_mask(path: Path) -> None:
    """The disc, as a mask."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((255 * disc()).astype(np.uint8)).save(path)


def normalisation() -> np.ndarray:
    """From the unit sphere to the scene as it was."""
    scale = np.diag([2.5, 2.5, 2.5, 1.0])
    scale[:3, 3] = 3.0, -4.0, 0.5
    return scale


def neus_arrays(count: int = 3) -> dict[str, np.ndarray]:
    """Matrices with a factor of their own each, one of them negative, in the scene before it was normalised."""
    scale = normalisation()
    arrays = {}
    for i, pose in enumerate(poses(count)):
        world = np.eye(4)
        world[:3] = (K @ world_to_camera(pose)) @ np.linalg.inv(scale) * (1.0, -3.0, 0.2)[i % 3]
        arrays |= {f"world_mat_{i}": world, f"scale_mat_{i}": scale, f"world_mat_inv_{i}": np.linalg.inv(world)}
    return arrays


def write_neus(folder: Path, count: int = 3, arrays: dict[str, np.ndarray] | None = None, masks: bool = True) -> Path:
    """NeuS: names of masks differ from those of pictures."""
    for i in range(count):
        write_picture(folder / "image" / f"{i:06d}.png", alpha=False, grey=100 + i)
        if masks:
            write_mask(folder / "mask" / f"{i:03d}.png")
    np.savez(folder / "cameras_sphere.npz", **(neus_arrays(count) if arrays is None else arrays))
    return folder


def llff_table(count: int = 3) -> np.ndarray:
    """Rows of poses and bounds. Columns: down, right, backwards, position, (height, width, focal)."""
    rows = []
    for pose in poses(count):
        left, up, forward, position = pose[:3].T
        matrix = np.stack([-up, -left, -forward, position, [2 * SIZE, 2 * SIZE, 2 * F]], axis=1)
        rows.append([*matrix.ravel(), 1.0, 4.0])
    return np.array(rows)


def write_llff(folder: Path, count: int = 3, table: np.ndarray | None = None, place: str = "images") -> Path:
    """LLFF: the cameras are of pictures twice as large."""
    for i in range(count):
        write_picture(folder / place / f"IMG_{i}.png", alpha=False)
    np.save(folder / "poses_bounds.npy", llff_table(count) if table is None else table)
    return folder


def middlebury_lines(count: int = 3) -> list[str]:
    """The number of pictures, and a line for each."""
    lines = [str(count)]
    for i, pose in enumerate(poses(count)):
        world = world_to_camera(pose)
        values = " ".join(f"{x:.14f}" for x in (*K.ravel(), *world[:, :3].ravel(), *world[:, 3]))
        lines.append(f"dino{i + 1:04d}.png {values}")
    return lines


def write_middlebury(folder: Path, lines: list[str] | None = None) -> Path:
    """Middlebury: pictures beside the file."""
    for i in range(3):
        write_picture(folder / f"dino{i + 1:04d}.png", alpha=False)
    (folder / "dino_par.txt").write_text("\n".join(middlebury_lines() if lines is None else lines) + "\n")
    return folder


CALIBRATION = {"f": F, "cx": CENTRE[0] - SIZE / 2, "cy": CENTRE[1] - SIZE / 2}
# A rotation by a quarter turn about x, a translation, and a scale.
WORLD = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float), np.array([0.5, -1.0, 2.0]), 4.0


def metashape_xml(
    count: int = 3,
    calibration: dict[str, float] | None = None,
    kind: str = "frame",
    transform: str = "",
    cameras: str = "",
    suffix: str = "",
) -> str:
    """An export of cameras. `transform`: of the component; `cameras`: more of them."""
    values = "".join(f"<{name}>{value!r}</{name}>" for name, value in (calibration or CALIBRATION).items())
    size = f'<resolution width="{SIZE}" height="{SIZE}"/>'
    entries = ""
    for i, pose in enumerate(poses(count)):
        matrix = " ".join(f"{x:.15g}" for x in (pose @ LEFT_UP).ravel())
        label = f'id="{i}" sensor_id="0" component_id="0" label="IMG_{i}{suffix}"'
        entries += f"<camera {label}><transform>{matrix}</transform><orientation>1</orientation></camera>\n"
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0">\n  <chunk label="Chunk 1" enabled="true">\n'
        f'<sensors next_id="1"><sensor id="0" label="unknown" type="{kind}">{size}'
        f'<calibration type="{kind}" class="initial">{size}<f>99</f></calibration>'
        f'<calibration type="{kind}" class="adjusted">{size}{values}</calibration></sensor></sensors>\n'
        f'<components next_id="1" active_id="0"><component id="0">{transform}</component></components>\n'
        f'<cameras next_id="9"><group id="0" label="Group 1" type="folder">{entries}</group>{cameras}</cameras>\n'
        "<reference>LOCAL_CS</reference></chunk></document>\n"
    )


def similarity(rotation: np.ndarray, translation: np.ndarray, scale: float) -> str:
    """The transform of a chunk or a component."""
    numbers = (" ".join(map(str, np.ravel(part))) for part in (rotation, translation, scale))
    names = ("rotation", "translation", "scale")
    parts = "".join(f'<{n} locked="true">{part}</{n}>' for n, part in zip(names, numbers, strict=True))
    return f"<transform>{parts}</transform>"


def write_metashape(folder: Path, xml: str | None = None, count: int = 3) -> Path:
    """Metashape: pictures as cameras call them, in capitals."""
    for i in range(count):
        write_picture(folder / "images" / f"IMG_{i}.PNG", alpha=False)
    (folder / "cameras.xml").write_text(metashape_xml(count) if xml is None else xml)
    return folder
