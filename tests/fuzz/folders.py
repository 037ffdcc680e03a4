"""Folders: photographs, as `jaxdr.load_views` reads them, and results, as `jaxdr view` shows them."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from jaxdr.chart.table import COLUMNS, csv_text
from jaxdr.images import write_image
from jaxdr.view.write import write_page
from jaxdr.views.load import load_views
from tests.fuzz.kind import Kind
from tests.views.folders import FOCAL, SIZE, edit_json, write_colmap, write_nerf


def kinds() -> list[Kind]:
    """Photographs of each layout, and the results of a run and of a chart."""
    found = [
        Kind("transforms", _write_transforms, _read_views, ("*.json",), text=True),
        Kind("colmap_text", write_colmap, _read_views, ("cameras.txt", "images.txt"), text=True),
        Kind("view_texts", _write_run, _read_run, ("*.json", "*.csv", "*.obj"), text=True),
        Kind("view_files", _write_run, _read_run, ("*.glb", "*.ply", "*.stl", "*.png", "*.jpg", "*.gif", "*.pfm")),
        Kind("chart", _write_chart, _read_run, ("*.json", "*.csv"), text=True),
    ]
    if importlib.util.find_spec("pycolmap") is not None:
        found.append(Kind("colmap_binary", write_binary_colmap, _read_views, ("*.bin",)))
    return found


def write_binary_colmap(folder: Path) -> None:
    """A COLMAP model, as COLMAP itself writes it, whose images have points."""
    import pycolmap

    model = write_colmap(folder) / "sparse" / "0"
    found = pycolmap.Reconstruction(str(model))
    track = pycolmap.Track()
    for image in found.images.values():
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array([3.0, 4.0]))])
        track.add_element(image.image_id, 0)
    found.add_point3D(np.zeros(3), track)
    found.write_binary(str(model))
    for path in model.glob("*.txt"):
        path.unlink()


def _write_transforms(folder: Path) -> None:
    write_nerf(folder)
    lens = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": 8.0, "cy": 8, "w": SIZE, "h": float(SIZE), "k1": 0.0}
    lens |= {"camera_model": "PINHOLE", "is_fisheye": False}

    def change(document: dict) -> None:
        document.update(lens)
        document["frames"][1].update(held_out=True, mask_path=None)
        document["frames"][2].update(fl_x=30.0, fl_y=30.0, file_path="train/../train/r_2.png")

    edit_json(folder / "transforms_train.json", change)


def _read_views(folder: Path) -> None:
    for view in load_views(folder).views:
        assert np.isfinite([view.focal, *view.centre, view.fov, *view.to_world.ravel()]).all()


def _write_run(folder: Path) -> None:
    for name in ("pictures", "meshes", "test"):
        (folder / name).mkdir()
    _write_json(folder / "config.json", {"output": "run", "target": {"shape": "sphere"}, "seed": 1})
    _write_json(folder / "metrics.json", {"seconds": 1.5, "device": "<cpu>", "views": [1, 2], "errors": {"a": 0.25}})
    (folder / "metrics.csv").write_text("iteration,loss,name\n1,0.5,\n2,0.25,a\n3,0.1,b\n")
    box = trimesh.creation.box()
    for name in ("meshes/00000.glb", "meshes/00002.glb", "asset.ply", "other.obj", "last.stl"):
        box.export(folder / name)
    picture = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    for name in ("pictures/00000.png", "pictures/00002.png", "a.jpg", "b.gif", "test/r_0.png"):
        picture.save(folder / name)
    write_image(folder / "light.pfm", np.ones((4, 4, 3), np.float32))


def _write_chart(folder: Path) -> None:
    _write_json(folder / "chart.json", {"output": "chart"})
    _write_json(folder / "summary.json", {"measured": 6})
    row = {"scene": "ball", "status": "ok"}
    rows = [
        row | {"estimator": name, "samples": count, "seconds": 0.1 * count, "rmse": 1 / count}
        for name in ("KernelDensity", "WarpedArea")
        for count in (1, 4)
    ]
    (folder / "rows.csv").write_text(csv_text(rows, COLUMNS))


def _read_run(folder: Path) -> None:
    page = write_page(folder).read_text(encoding="utf-8")
    assert not re.search(r' (?:[cxy12]+|points)="[^"]*(?:nan|inf)', page)  # places in a diagram


def _write_json(path: Path, document: dict) -> None:
    path.write_text(json.dumps(document))
