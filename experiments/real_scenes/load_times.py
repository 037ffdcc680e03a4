"""Load times of a scene of 2 million faces in 600 shapes, by versions of jaxdr and by Mitsuba, in turns.

The scene is an XML file with 600 meshes, 200 each as OBJ, PLY and serialized. There is another file without the
serialized ones, which old versions can't read. A version is a folder with a checkout. Every loading has a process of
its own.
"""

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np

from experiments.common import results, scratch
from experiments.real_scenes.mitsuba_meshes import hill, serialized

SHAPES, FACES = 600, 2_000_000
OURS = """
import time, warnings, sys
warnings.simplefilter("ignore")
import jaxdr
started, worked = time.perf_counter(), time.process_time()
scene = jaxdr.load_mitsuba(sys.argv[1])
seconds = time.perf_counter() - started, time.process_time() - worked
print(*seconds, len(scene.shapes), sum(len(s.mesh.faces) for s in scene.shapes.values()))
"""
MITSUBA = """
import time, sys
import mitsuba
mitsuba.set_variant("scalar_rgb")
started, worked = time.perf_counter(), time.process_time()
scene = mitsuba.load_file(sys.argv[1])
seconds = time.perf_counter() - started, time.process_time() - worked
print(*seconds, len(scene.shapes()), sum(shape.face_count() for shape in scene.shapes()))
"""


def write(folder, shapes, faces):
    """The scene with all formats, and one with OBJ and PLY alone; their paths."""
    import trimesh

    folder.mkdir(parents=True, exist_ok=True)
    mesh = hill(round((faces / shapes / 2) ** 0.5) + 1)
    bare = {name: mesh[name] for name in ("vertices", "faces")}
    trimesh.Trimesh(bare["vertices"], bare["faces"], process=False).export(folder / "hill.ply")
    with (folder / "hill.obj").open("w") as file:
        np.savetxt(file, bare["vertices"], fmt="v %.7g %.7g %.7g")
        np.savetxt(file, bare["faces"] + 1, fmt="f %d %d %d")
    (folder / "hill.serialized").write_bytes(serialized([bare]))
    paths = []
    for name, kinds in (("all", ("obj", "ply", "serialized")), ("plain", ("obj", "ply"))):
        lines = ['<scene version="3.0.0"><sensor type="perspective"/>']
        for i in range(shapes):
            kind = kinds[i % len(kinds)]
            lines.append(
                f'<shape type="{kind}" id="s{i}"><string name="filename" value="hill.{kind}"/>'
                f'<transform name="to_world"><translate x="{2 * (i % 25)}" y="{2 * (i // 25)}"/></transform></shape>'
            )
        paths.append(folder / f"{name}.xml")
        paths[-1].write_text("\n".join([*lines, "</scene>"]))
    return paths


def timed(program, path, folder):
    """(seconds, processor seconds, shapes, faces) of one loading in a fresh process, with the package of `folder`."""
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], cwd=folder, capture_output=True, text=True, check=True
    )
    seconds, work, shapes, faces = done.stdout.split()[-4:]
    return float(seconds), float(work), int(shapes), int(faces)


def main():
    """Load in turns and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--versions", nargs="+", required=True, help="name=folder of a checkout")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    size = (12, 20_000) if options.quick else (SHAPES, FACES)
    whole, plain = (path.resolve() for path in write(scratch("real_scenes") / "load_times", *size))
    cases = {"Mitsuba, all": (MITSUBA, whole, "."), "Mitsuba, OBJ and PLY": (MITSUBA, plain, ".")}
    for version in options.versions:
        name, _, folder = version.partition("=")
        cases[f"{name}, OBJ and PLY"] = (OURS, plain, Path(folder).resolve())
        cases[f"{name}, all"] = (OURS, whole, Path(folder).resolve())
    found = {}
    for _ in range(options.rounds):
        for name, case in cases.items():
            try:
                found.setdefault(name, []).append(timed(*case))
            except subprocess.CalledProcessError as error:
                found.setdefault(name, []).append(None)
                print(name, error.stderr.strip().splitlines()[-1][:200])
    lines = ["| | seconds (median) | fastest | processor seconds | shapes | faces |", "| --- " * 6 + "|"]
    for name, times in found.items():
        done = [time for time in times if time]
        seconds = [time[0] for time in done]
        cells = (
            [
                f"{statistics.median(seconds):.2f}",
                f"{min(seconds):.2f}",
                f"{statistics.median(time[1] for time in done):.2f}",
                *map(str, done[0][2:]),
            ]
            if done
            else ["refused"]
        )
        lines.append(f"| {name} | {' | '.join(cells)} |")
    print("\n".join(lines))
    folder = results("real_scenes", options.quick)
    (folder / "load_times.md").write_text("\n".join(lines) + "\n")
    (folder / "load_times.json").write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
