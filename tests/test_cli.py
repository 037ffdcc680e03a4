"""The command line: what it writes, and one line with exit code 2 for every mistake."""

import signal
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

import jaxdr as jd
from jaxdr import cli
from jaxdr.images import load_image
from jaxdr.optimize import phase, shape

from .optimize.fake import render as fake_optimize_render

SCENE = """<scene version="3.0.0">
    <default name="width" value="8"/>
    <sensor type="perspective" id="camera">
        <float name="fov" value="60"/>
        <transform name="to_world"><lookat origin="0, -4, 0" target="0, 0, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="$width"/><integer name="height" value="6"/></film>
    </sensor>
    <shape type="cube" id="spot"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></shape>
    <emitter type="constant"><rgb name="radiance" value="0.5, 0.5, 0.5"/></emitter>
</scene>
"""
CONFIG = """output = "run"
[target]
shape = "sphere"
parameters = { subdivisions = 1 }
[initial]
subdivisions = 1
[cameras]
views = 2
resolution = 8
[optimizer]
iterations = 4
views_per_step = 1
[integrator]
max_depth = 2
[report]
chamfer_samples = 100
"""


@pytest.fixture(autouse=True)
def workplace(tmp_path, monkeypatch):
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "run.toml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "_keep_programs", lambda options: None)  # tests/test_program_cache.py
    return tmp_path


@pytest.fixture
def scenes(monkeypatch):
    """Stand-in for the renderer that keeps what it was asked for; d image / d x of a vertex is 1 in every pixel."""
    asked = []

    def render(scene, key, spp, integrator):
        asked.append((scene, spp, integrator))
        film = scene.camera.film
        total = sum(scene.shapes["spot"].mesh.vertices[:, 0]) + scene.shapes["spot"].bsdf.reflectance.sum()
        ramp = jnp.linspace(-1.0, 1.0, film.width)[None, :, None]
        return jnp.broadcast_to(ramp * total, (film.height, film.width, 3))

    monkeypatch.setattr(cli, "render", render)
    return asked


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_render_a_constant_sky_on_a_grey_cube(workplace):
    # Nothing but the sky lights the convex cube: radiance times reflectance.
    assert cli.main(["render", "scene.xml", "-o", "out.npy", "--spp", "64", "--max-depth", "2"]) == 0
    image = np.load("out.npy")
    assert image.shape == (6, 8, 3)
    np.testing.assert_allclose(image[2:4, 3:5], 0.25, rtol=0.05)
    np.testing.assert_allclose(image[0, 0], 0.5, rtol=0.03)  # the tail of the pixel filter may meet the cube


def test_render_formats_and_options(workplace, scenes, capsys):
    arguments = ["--spp", "3", "--max-depth", "5", "--set", "width=10", "--set", "camera.fov=20"]
    arguments += ["--set", "spot.bsdf.reflectance=[0.1, 0.2, 0.3]", "--set", "environment.radiance=2"]
    with jax.disable_jit():  # so that the scene has values
        assert cli.main(["render", "scene.xml", "-o", "out.png", *arguments]) == 0
    assert capsys.readouterr().out == "out.png\n"
    assert np.asarray(Image.open("out.png")).shape == (6, 10, 3)
    scene, spp, integrator = scenes[-1]
    assert (spp, integrator.max_depth, integrator.boundary) == (3, 5, None)
    assert float(scene.camera.fov) == 20.0
    np.testing.assert_allclose(scene.shapes["spot"].bsdf.reflectance, [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(scene.environment.radiance, 2.0)


INTEGRATOR = '<integrator type="path"><integer name="max_depth" value="{}"/></integrator>'


@pytest.mark.parametrize("asked, depth", [(5, 5), (-1, cli.DEEPEST), (65, cli.DEEPEST)])
def test_settings_of_the_file(workplace, scenes, capsys, asked, depth):
    """Depth and samples are the file's, up to what is practical; options come first."""
    text = Path("scene.xml").read_text()
    text = text.replace('<scene version="3.0.0">', '<scene version="3.0.0">' + INTEGRATOR.format(asked), 1)
    sampler = '<sampler type="independent"><integer name="sample_count" value="7"/></sampler></sensor>'
    Path("deep.xml").write_text(text.replace("</sensor>", sampler, 1))
    assert cli.main(["render", "deep.xml", "-o", "out.npy"]) == 0
    _, spp, integrator = scenes[-1]
    assert (spp, integrator.max_depth) == (7, depth)
    assert ("--max-depth" in capsys.readouterr().err) == (asked != depth)
    assert cli.main(["render", "deep.xml", "-o", "out.npy", "--max-depth", "4", "--spp", "2"]) == 0
    assert (scenes[-1][1], scenes[-1][2].max_depth) == (2, 4)


def test_many_samples_in_passes(workplace, scenes, monkeypatch):
    monkeypatch.setattr(cli, "PASS", 100)
    assert cli.main(["render", "scene.xml", "-o", "out.npy", "--spp", "5"]) == 0
    assert [spp for _, spp, _ in scenes] == [2, 1]  # 8 x 6 pixels; both programs are compiled once
    np.testing.assert_allclose(np.load("out.npy")[0, -1], np.load("out.npy")[-1, -1])


@pytest.mark.parametrize("suffix, beside", [(".png", ".npy"), (".pfm", ".pfm")])
def test_aovs_beside_the_image(workplace, scenes, capsys, suffix, beside):
    assert cli.main(["render", "scene.xml", "-o", f"out{suffix}", "--spp", "4", "--aov", "depth, face,position"]) == 0
    files = [f"out{suffix}", *(f"out.{name}{beside}" for name in ("depth", "face", "position"))]
    assert capsys.readouterr().out.splitlines() == files and set(files) < set(names(workplace))
    depth, face, position = (load_image(name) for name in files[1:])
    assert (depth.shape, face.shape, position.shape) == ((6, 8, 1), (6, 8, 1), (6, 8, 3))
    assert np.allclose(depth[3, 4], 3, atol=0.2) and np.allclose(position[3, 4, 1], -1, atol=0.01)
    assert face.min() == -1 and 0 <= face[3, 4] < 12


@pytest.mark.parametrize("suffix", [".png", ".exr", ".hdr", ".pfm", ".npy"])
def test_every_image_format(scenes, suffix):
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    arguments = ["--set", "spot.vertices=0.1", "--set", "spot.bsdf.reflectance=1"]
    assert cli.main(["render", "scene.xml", "-o", f"out{suffix}", *arguments]) == (2 if suffix == ".hdr" else 0)
    if suffix != ".hdr":  # the stand-in image has negative values, which .hdr can't hold
        expected = np.broadcast_to(np.linspace(-3.8, 3.8, 8)[None, :, None], (6, 8, 3))
        expected = np.clip(expected, 0, 1) if suffix == ".png" else expected
        np.testing.assert_allclose(load_image(f"out{suffix}"), expected, rtol=1e-5, atol=0.004 * (suffix == ".png"))


def test_what_a_scene_has_and_jaxdr_has_not(workplace, scenes, capsys):
    text = SCENE.replace("</scene>", '<emitter type="sunsky"/><shape type="hair"/></scene>')
    (workplace / "hairy.xml").write_text(text)
    assert cli.main(["render", "hairy.xml", "-o", "out.npy"]) == 2
    first, *rest = capsys.readouterr().err.splitlines()
    assert first == "jaxdr: error: hairy.xml has 2 problems:"
    assert [line.split(";")[0] for line in rest] == [
        "  hairy.xml, line 10, <shape>: unknown type 'hair'",
        "  hairy.xml, line 10, <emitter>: unknown type 'sunsky'",
    ]
    assert "out.npy" not in names(workplace)
    assert cli.main(["render", "hairy.xml", "-o", "out.npy", "--ignore-unsupported"]) == 0
    captured = capsys.readouterr()
    assert captured.out == "out.npy\n"
    assert [line[:29] for line in captured.err.splitlines()] == ["jaxdr: warning: hairy.xml, li"] * 2


@pytest.mark.parametrize("name, integrator", [("bdpt", jd.BidirectionalPathTracer), ("path", jd.PathTracer)])
def test_render_with_an_integrator(name, integrator, monkeypatch):
    asked = []

    def render(scene, key, spp, integrator):
        asked.append(integrator)
        return jnp.zeros((6, 8, 3))

    monkeypatch.setattr(cli, "render", render)
    assert cli.main(["render", "scene.xml", "-o", "out.npy", "--integrator", name, "--max-depth", "4"]) == 0
    assert asked == [integrator(4, boundary=None)]


def test_render_a_glb_under_a_white_sky(workplace, capsys):
    box = trimesh.creation.box()
    material = PBRMaterial(baseColorFactor=[0.5, 0.5, 0.5, 1.0], metallicFactor=0.0)
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(box.vertices), 2)), material=material)
    trimesh.Scene({"spot": box}).export(workplace / "box.glb")
    size = ["--set", "width=8", "--set", "height=6"]
    assert cli.main(["render", "box.glb", "-o", "out.npy", *size, "--spp", "64", "--max-depth", "2"]) == 0
    image = np.load("out.npy")
    assert image.shape == (6, 8, 3)
    # The base scatters half of it; the surface (index 1.5) reflects 4 % more, and more still at an angle.
    assert np.all((image[2:4, 3:5] > 0.5) & (image[2:4, 3:5] < 0.58))
    np.testing.assert_allclose(image[0, 0], 1, rtol=0.03)
    assert cli.main(["render", "box.glb", "-o", "out.npy", "--set", "kind=3"]) == 2
    assert "--set kind=3: a glTF file takes width and height, whole pixels" in capsys.readouterr().err


def test_gradient_values_and_pictures(workplace, scenes, capsys):
    assert cli.main(["gradient", "scene.xml", "--wrt", "spot.translate.x", "-o", "g"]) == 0
    written = capsys.readouterr().out.split()
    assert written[:2] == ["g.png", "g.npy"] and set(written) <= {"g.png", "g.npy", "g.exr"}
    count = len(scenes[-1][0].shapes["spot"].mesh.vertices)
    expected = np.broadcast_to(count * np.linspace(-1, 1, 8)[None, :, None], (6, 8, 3))
    np.testing.assert_allclose(np.load("g.npy"), expected, rtol=1e-5, atol=1e-5)
    picture = np.asarray(Image.open("g.png")).astype(int)
    middle = picture[len(picture) // 2]
    assert middle[5, 2] > middle[5, 0] + 50  # negative on the left: blue

    assert cli.main(["gradient", "scene.xml", "--wrt", "spot.bsdf.reflectance", "-o", "r.npy"]) == 0
    np.testing.assert_allclose(np.load("r.npy"), expected * 3 / count, rtol=1e-5, atol=1e-5)
    assert "r.png" not in names(workplace)


def test_boundary_is_chosen(scenes):
    for name, is_none in (("KernelDensity", False), ("none", True)):
        arguments = ["--wrt", "spot.translate.x", "-o", "g.npy", "--boundary", name]
        assert cli.main(["gradient", "scene.xml", *arguments]) == 0
        assert (scenes[-1][2].boundary is None) == is_none


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("render nothing.xml -o out.png", "nothing.xml"),
        ("render scene.xml -o out.jpg", "unknown image format '.jpg'"),
        ("render scene.xml -o nowhere/out.png", "folder nowhere does not exist"),
        ("render scene.xml", "the following arguments are required: -o/--output"),
        ("render scene.xml -o out.png --spp 0", "argument --spp: must be positive, got 0"),
        ("render scene.xml -o out.png --spp many", "argument --spp: invalid whole number value: 'many'"),
        (
            "render scene.xml -o out.png --aov depth,colour",
            "argument --aov: unknown AOV 'colour'; known: alpha, depth, position",
        ),
        ("render scene.xml -o out.png --sp 3", "unrecognized arguments: --sp 3"),
        ("render scene.xml -o out.png --set widht=3", "widht"),
        ("render scene.xml -o out.png --set width", "--set width: expected key=value"),
        (
            "render scene.xml -o out.png --set camera.foo=3",
            "--set camera.foo: unknown parameter; scene.xml has: spot.vert",
        ),
        (
            "render scene.xml -o out.png --set camera.fov=wide",
            "--set camera.fov: expected numbers of shape [] or one number",
        ),
        (
            "render scene.xml -o out.png --set spot.bsdf.reflectance=[1,2]",
            "expected numbers of shape [3] or one number",
        ),
        ("gradient scene.xml -o out.png", "the following arguments are required: --wrt"),
        ("gradient scene.xml --wrt spot.translat.x -o out.png", "did you mean 'spot.translate.x'?"),
        (
            "gradient scene.xml --wrt spot.translate.x -o out.png --boundary x",
            "WarpedArea, none, got 'x' (or FILE.py:CLASS or",
        ),
        ("gradient scene.xml --wrt spot.translate.x -o out.hdr", "out.hdr: derivatives have negative values"),
        ("optimize nothing.toml", "nothing.toml: can't be read"),
        ("optimize run.toml --set optimizer.lamb=3", "run.toml: optimizer.lamb: unknown key; did you mean 'lam'?"),
        ("optimize run.toml --resume", "output run: there is no shape optimisation to resume"),
        ("optimize run.toml --resume --overwrite", "exclude each other"),
        ("optimise run.toml", "invalid choice: 'optimise'"),
        ("", "the following arguments are required: COMMAND"),
    ],
)
def test_mistakes_end_with_one_line(workplace, capsys, arguments, message):
    (workplace / "out.png").write_text("old")
    before = names(workplace)
    assert cli.main(arguments.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("jaxdr: error: ") and captured.err.count("\n") == 1
    assert message in captured.err
    assert names(workplace) == before
    assert (workplace / "out.png").read_text() == "old"


def test_the_version(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["--version"])
    assert not ended.value.code and capsys.readouterr().out == f"jaxdr {jd.__version__}\n"


def test_debug_shows_the_traceback():
    with pytest.raises(ValueError, match=r"nothing\.xml"):
        cli.main(["render", "nothing.xml", "-o", "out.png", "--debug"])


def test_optimize_stops_at_ctrl_c_and_resumes(workplace, monkeypatch, capsys):
    monkeypatch.setattr(phase, "render", fake_optimize_render)
    original = shape.RunFolder.add_metrics

    def add_metrics(self, row):
        original(self, row)
        if row["iteration"] == 2:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(shape.RunFolder, "add_metrics", add_metrics)
        assert cli.main(["optimize", "run.toml", "--set", "seed=4"]) == 130
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == (
        "jaxdr: stopped after step 2; checkpoint in run/checkpoint.npz; "
        "go on with: jaxdr optimize run.toml --set seed=4 --resume"
    )
    assert cli.main(["optimize", "run.toml"]) == 2
    assert "already holds results; give --resume or --overwrite" in capsys.readouterr().err
    assert cli.main(["optimize", "run.toml", "--set", "seed=4", "--resume"]) == 0
    assert capsys.readouterr().out.startswith("run: Chamfer distance ")


def test_nan_ends_with_exit_code_1(workplace, monkeypatch, capsys):
    def nan_render(scene, key, spp, integrator):
        film = scene.camera.film
        return jnp.ones((film.height, film.width, 3)).at[1, 2].set(jnp.nan)

    monkeypatch.setattr(phase, "render", nan_render)
    monkeypatch.setattr(cli, "render", nan_render)
    assert cli.main(["optimize", "run.toml"]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "jaxdr: error: the target image of view 0 is not finite"
    assert cli.main(["render", "scene.xml", "-o", "out.png"]) == 1
    assert "1 pixels are not finite, the first in row 1, column 2" in capsys.readouterr().err
    assert "out.png" not in names(workplace)


def test_module_runs_as_a_program():
    done = subprocess.run(
        [sys.executable, "-m", "jaxdr.cli", "optimize", "nothing.toml", "--no-cache"],
        capture_output=True,
        text=True,
        cwd=cli.__file__[:-13],
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr == "jaxdr: error: nothing.toml: can't be read (No such file or directory); expected a TOML file\n"
    )


def test_ctrl_c_while_the_command_is_imported_prints_one_line():
    program = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from jaxdr.__main__ import run\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'jaxdr.cli': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "run()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (130, "jaxdr: interrupted\n")


def test_ctrl_c_after_the_end_prints_no_traceback():
    """The process is interrupted while it cleans up behind a command that has ended."""
    code = (
        "import atexit, os, signal\n"
        # What a shell starts in the background ignores Ctrl-C, and so do its children.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from jaxdr import __main__\n"
        "__main__.main = lambda: 7\n"
        "atexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
        "__main__.run()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == -signal.SIGINT
    assert "Traceback" not in done.stderr
