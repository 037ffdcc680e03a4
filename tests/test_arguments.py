"""Arguments of the wrong kind get one clear error. In a process of its own: the tests' type checker would be first."""

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import jax, numpy as np, jaxdr as jd
pose, key = np.eye(4), jax.random.key(0)
shapes, camera = {"box": jd.Shape(jd.shapes.box())}, jd.Perspective(pose, 40.0, jd.Film(4, 4))
scene = jd.Scene(shapes, camera)
for case in CASES:
    try:
        eval(case)
    except ValueError as error:
        print(f"{case} -> {error}".splitlines()[0])
"""
CASES = {
    "jd.Film(4.5, 4)": "Film: width must be a whole number, got 4.5",
    "jd.Film(float('nan'), 4)": "Film: width must be a whole number, got nan",
    "jd.Film('4', 4)": "Film: width must be a whole number, got '4'",
    "jd.Film(4, 4, jd.Box)": "Film: filter must be a pixel filter such as jaxdr.Box(), got the class Box",
    "jd.Film(4, 4, 'box')": "Film: filter must be a pixel filter such as jaxdr.Box(), got 'box'",
    "jd.Film(4, 4, crop=(0, 0, 1))": "Film: crop must be four whole numbers, or None, got (0, 0, 1)",
    "jd.Film(4, 4, crop=(0.5, 0, 1, 1))": "Film: crop must be four whole numbers",
    "jd.Scene(shapes, None)": "Scene: camera must be a camera such as jaxdr.Perspective(...), got None",
    "jd.Scene(shapes, pose)": "Scene: camera must be a camera such as jaxdr.Perspective(...), got an array",
    "jd.Scene(shapes, camera, 1.0)": "an environment such as jaxdr.ConstantEnvironment(), or None, got 1.0",
    "jd.Scene([shapes], camera)": "Scene: shapes must be a dictionary by name, such as {'ball': ...}, got [{'box'",
    "jd.Scene(shapes, camera, None, [1])": "Scene: lights must be a dictionary by name, such as {'ball': ...}, got [1]",
    "jd.Diffuse('red')": "Diffuse: reflectance must be made of numbers, got 'red'",
    "jd.Phong(exponent='high')": "Phong: exponent must be made of numbers, got 'high'",
    "jd.AreaEmitter(['a', 1, 2])": "radiance must be made of numbers, got ['a', 1, 2]",
    "jd.EnvironmentMap('sky.hdr')": "EnvironmentMap: radiance must be made of numbers, got 'sky.hdr'; jaxdr.load_image",
    "jd.Bitmap('wood.png')": "must be made of numbers, got 'wood.png'; jaxdr.load_image reads files",
    "jd.PathTracer(2.5)": "PathTracer: max_depth must be a whole number, got 2.5",
    "jd.PathTracer('3')": "must be a whole number, got '3'",
    "jd.BidirectionalPathTracer(None)": "max_depth must be a whole number, got None",
    "jd.PathTracer(0)": "PathTracer: max_depth must be at least 1 (emitters seen directly)",
    "jd.render(scene, key, 0)": "render: spp must be a positive whole number of samples per pixel, got 0",
    "jd.Film(0, 4)": "Film: width and height must be at least 1 pixel, got 0 x 4",
    "jd.render(scene, 0)": "render: key must be a random key such as jax.random.key(0), got 0",
    "jd.render(scene, None)": "render: key must be a random key such as jax.random.key(0), got None",
    "jd.render(scene, jax.numpy.zeros(3))": "render: key must be a random key",
    "jd.derivative_terms(scene, 1)": "derivative_terms: key must be a random key",
    "jd.render_aovs(scene, 1)": "render_aovs: key must be a random key",
    "jd.plan(scene, key=1)": "plan: key must be a random key",
    "jd.render(scene, key, 4, jd.PathTracer)": "such as jaxdr.PathTracer(), or None, got the class PathTracer",
    "jd.render(scene, key, 4, 'path')": "such as jaxdr.PathTracer(), or None, got 'path'",
    "jd.render(scene, key, float('nan'))": "render: spp must be a whole number, got nan",
    "jd.render(scene, key, None)": "render: spp must be a whole number, got None",
    "jd.render(scene, key, '4')": "render: spp must be a whole number, got '4'",
    "jax.jit(lambda n: jd.render(scene, key, n))(4)": "render: spp must be a whole number, got a traced value",
    "jd.render_aovs(scene, key, float('inf'))": "render_aovs: spp must be a whole number, got inf",
    "jd.render_aovs(None, key)": "render_aovs: scene must be a jaxdr.Scene, got None",
    "jd.render_aovs(scene, key, 1, 'height')": "render_aovs: names has an unknown name 'height'; known: ",
}


def test_messages():
    program = f"CASES = {list(CASES)}\n{PROGRAM}"
    run = [sys.executable, "-c", program]
    done = subprocess.run(run, capture_output=True, text=True, cwd=Path(__file__).parents[1], timeout=300)
    assert done.returncode == 0, done.stderr
    found = dict(line.split(" -> ", 1) for line in done.stdout.splitlines() if " -> " in line)
    assert set(found) == set(CASES)
    for case, message in CASES.items():
        assert message in found[case], case
