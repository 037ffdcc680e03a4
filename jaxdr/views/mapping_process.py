"""A program that finds cameras by pycolmap. It is started by `jaxdr.views.registration`, as a process of its own.

It is one because pycolmap and Pillow bring different zlibs: where both are loaded, PNG files may end the process. So
pycolmap also can't change this process's logging, random numbers or signals. Nothing of jaxdr is imported here.

    python mapping_process.py JOB.json

Lines on stdout are JSON: {"stage", "done", "total"} after each piece of work, {"result"} at the end. `JOB.json` holds

- `photographs`: the folder; `cameras`: lists of the names in it that share a camera;
- `pairs`: pairs of names whose features are compared;
- `work`: a folder for temporary files; `model`: the folder for cameras, images and points; `seed`; `threads`;
- `lens`: COLMAP's name of the lens model; `longest`: most pixels along the longer side for features.
"""

import json
import sys
from pathlib import Path
from typing import Any

import pycolmap

PHOTOGRAPHS, PAIRS = 4, 64  # in a piece of work, for the progress; the result doesn't depend on them
FEWEST = 3  # photographs of a model


def main(job: dict[str, Any]) -> dict[str, Any]:
    """Find the cameras, write the largest model, and return its numbers."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.ERROR)
    pycolmap.set_random_seed(job["seed"])
    database, photographs = Path(job["work"]) / "features.db", Path(job["photographs"])
    _import(job, database, photographs)
    if left := sorted({name for names in job["cameras"] for name in names} - set(_names(database).values())):
        return {"unreadable": left}
    _find_features(job, database, photographs)
    _match(job, database)
    return _map(job, database, photographs)


def _import(job: dict[str, Any], database: Path, photographs: Path) -> None:
    # First of all, by one thread: the numbers of the photographs must not depend on who is ready first.
    pycolmap.Database.open(database).close()
    options = pycolmap.ImageReaderOptions()
    options.camera_model = job["lens"]
    for names in job["cameras"]:
        pycolmap.import_images(database, photographs, pycolmap.CameraMode.SINGLE, names, options)


def _find_features(job: dict[str, Any], database: Path, photographs: Path) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.max_image_size, options.num_threads = False, job["longest"], job["threads"]
    total, done = sum(map(len, job["cameras"])), 0
    for names in job["cameras"]:
        for start in range(0, len(names), PHOTOGRAPHS):
            some = names[start : start + PHOTOGRAPHS]
            pycolmap.extract_features(
                database,
                photographs,
                some,
                pycolmap.CameraMode.SINGLE,
                extraction_options=options,
                device=pycolmap.Device.cpu,
            )
            done += len(some)
            _say(stage="features", done=done, total=total)


def _match(job: dict[str, Any], database: Path) -> None:
    options, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    options.use_gpu, options.num_threads = False, job["threads"]
    verification.ransac.random_seed = job["seed"]
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = Path(job["work"]) / "pairs.txt"
    pairs, names = job["pairs"], _names(database)
    # Lists of pairs have no way to write spaces in names.
    numbers = {name: str(number) for number, name in names.items()}
    _rename(database, {number: str(number) for number in names})
    for start in range(0, len(pairs), PAIRS):
        some = pairs[start : start + PAIRS]
        pairing.match_list_path.write_text("".join(f"{numbers[a]} {numbers[b]}\n" for a, b in some), encoding="utf-8")
        pycolmap.match_image_pairs(database, options, pairing, verification, device=pycolmap.Device.cpu)
        _say(stage="pairs", done=start + len(some), total=len(pairs))
    _rename(database, names)


def _map(job: dict[str, Any], database: Path, photographs: Path) -> dict[str, Any]:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed, options.min_model_size = job["seed"], FEWEST
    options.num_threads = 1  # more would add numbers up in another order each time
    total, done = sum(map(len, job["cameras"])), 0

    def count(registered: int = 1) -> None:
        nonlocal done
        done += registered
        _say(stage="cameras", done=min(done, total), total=total)  # some belong to several models

    models = pycolmap.incremental_mapping(
        database,
        photographs,
        job["work"],
        options,
        initial_image_pair_callback=lambda: count(2),
        next_image_callback=count,
    )
    in_order = sorted(models.values(), key=lambda model: (-model.num_reg_images(), -model.num_points3D()))
    if not in_order or in_order[0].num_reg_images() < FEWEST:
        return {"registered": []}
    best = in_order[0]
    best.write(job["model"])
    cameras = [best.cameras[number] for number in sorted(best.cameras)]
    return {
        "registered": sorted(image.name for image in best.images.values() if image.has_pose),
        "error": best.compute_mean_reprojection_error(),
        "points": best.num_points3D(),
        "focal": [camera.mean_focal_length() for camera in cameras],
        "lens": job["lens"],
        "others": [model.num_reg_images() for model in in_order[1:]],
    }


def _names(database: Path) -> dict[int, str]:
    """The names of the photographs in the database by their numbers there."""
    opened = pycolmap.Database.open(database)
    names = {image.image_id: image.name for image in opened.read_all_images()}
    opened.close()
    return names


def _rename(database: Path, names: dict[int, str]) -> None:
    opened = pycolmap.Database.open(database)
    for image in opened.read_all_images():
        image.name = names[image.image_id]
        opened.update_image(image)
    opened.close()


def _say(**values: Any) -> None:
    print(json.dumps(values), flush=True)


if __name__ == "__main__":
    _say(result=main(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))))
