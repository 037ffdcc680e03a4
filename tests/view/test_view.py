"""`jaxdr view`: what the page of a folder shows, what is refused, and that a browser draws the meshes."""

import io
import json
import re
import shutil
import struct
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import jaxdr as jd
from jaxdr import cli
from jaxdr.chart.table import COLUMNS, csv_text
from jaxdr.optimize.config import optimize_config
from jaxdr.optimize.output import RunFolder
from jaxdr.optimize.recovery.config import recovery_config
from jaxdr.view import models
from jaxdr.view.curves import svg
from jaxdr.view.tables import Curve, Diagram

from .browser import BROWSER, show

BALL = jd.shapes.sphere(1)
RED = [220, 20, 20, 255]


@pytest.fixture(autouse=True)
def workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shades(*values: float) -> np.ndarray:
    return np.stack([np.full((8, 12, 3), value) for value in values])


def optimisation(steps=(0, 2, 4), finished=True) -> RunFolder:
    """The folder of a run from a sphere, as the loop writes it."""
    config = optimize_config({"output": "run", "target": {"shape": "sphere"}}, Path("run.toml"))
    folder = RunFolder(config)
    with folder.opened(resume=False, overwrite=False):
        pass
    folder.start_metrics(0)
    for i in range(1, 1 + steps[-1]):
        folder.add_metrics({"iteration": i, "loss": 10.0**-i, "vertices": 42, "chamfer": 0.1 / i if i % 2 else ""})
    folder.save_mesh("target", BALL)
    for step in steps:
        folder.save_grid(step, shades(0.5), shades(0.1 * step))
        folder.save_mesh(f"{step:05d}", BALL)
    if finished:
        folder.save_mesh("result", BALL)
        folder.save_summary({"seconds": 1.23456789, "device": "<cpu>", "views": list(range(9))})
    return folder


def page(*arguments: str) -> str:
    assert cli.main(["view", *arguments]) == 0
    path = Path(arguments[arguments.index("-o") + 1] if "-o" in arguments else f"{arguments[0]}/view.html")
    return path.read_text(encoding="utf-8")


def without_viewer(text: str) -> str:
    return re.sub(r'<script type="module">.*?</script>', "", text, flags=re.DOTALL)


def captions(text: str) -> list[str]:
    return re.findall(r"<figcaption>(.*?)</figcaption>", text)


def embedded(text: str, kind: str) -> list[bytes]:
    return [b64decode(data) for data in re.findall(f'src="data:{kind};base64,([^"]+)"', text)]


def test_a_run_from_its_start_to_its_result(capsys):
    folder = optimisation()
    text = page("run")
    captured = capsys.readouterr()
    assert captured.out == "run/view.html\n" and captured.err == ""
    assert captions(text) == ["target", "start", "result", "start", "result, step 4", "step 2"]
    pictures = [folder.path / "pictures" / f"{step:05d}.png" for step in (0, 4, 2)]
    assert embedded(text, "image/png") == [path.read_bytes() for path in pictures]
    assert len(embedded(text, "model/gltf-binary")) == 3
    titles = re.findall(r'<text class="title"[^>]*>(.*?)</text>', text)
    assert titles == ["loss", "chamfer"]  # the number of vertices does not change, the others are empty
    assert (
        "<tr><td>seconds</td><td>1.2346</td></tr>" in text and "&lt;cpu&gt;" in text and "views" not in captions(text)
    )
    assert "not finished" not in text and "&quot;subdivisions&quot;" in text


def test_a_run_that_goes_on():
    optimisation(finished=False)
    with open("run/metrics.csv", "a") as file:
        file.write("5,0.0")  # the line that is being written
    text = page("run")
    assert captions(text) == ["target", "start", "step 4", "start", "step 4", "step 2"]
    assert "The run is not finished." in text


def test_many_pictures_are_thinned():
    optimisation(steps=tuple(range(0, 60, 2)))
    shown = captions(page("run"))[3:]
    assert len(shown) == 12 and shown[:2] == ["start", "result, step 58"]
    steps = [int(name.split()[1]) for name in shown[2:]]
    assert steps == sorted(set(steps)) and max(np.diff([0, *steps, 58])) <= 6


def test_a_recovery_with_a_mesh_and_a_texture():
    table = {"output": "run", "scene": {"name": "star_light"}}
    table["parameters"] = [{"name": "light.vertices", "motion": "rigid", "initial": [0.0] * 6, "learning_rate": 0.1}]
    config = recovery_config(table, Path("run.toml"))
    folder = RunFolder(config, ("iteration", "loss", "seconds", "light"))
    with folder.opened(resume=False, overwrite=False):
        pass
    folder.start_metrics(0)
    for step in (0, 3):
        folder.add_metrics({"iteration": step, "loss": 1.0 + step, "light": 2.0})
        folder.save_mesh(f"{step:05d}.light", BALL)
        folder.save_texture(f"{step:05d}.sky", shades(0.3)[0])
        folder.save_grid(step, shades(0.5), shades(0.4))
    folder.save_summary({"errors": {"light": [0.5, 0.25]}})
    text = page("run")
    meshes = ["light, start", "light, result, step 3"]
    assert captions(text) == [*meshes, "start", "result, step 3", "sky, start", "sky, result, step 3"]
    assert "<td>errors.light</td><td>0.5, 0.25</td>" in text


def test_a_chart():
    folder = Path("chart")
    folder.mkdir()
    rows = [
        {"scene": "ball", "estimator": name, "samples": n, "status": "ok", "seconds": 0.1 * n, "rmse": error / n**0.5}
        for name, error in (("KernelDensity", 0.3), ("LineSampling", 0.1))
        for n in (1, 4, 16)
    ]
    rows.append({"scene": "ball", "estimator": "WarpedArea", "status": "refused"})
    (folder / "rows.csv").write_text(csv_text(rows, COLUMNS))
    (folder / "chart.json").write_text("{}")
    (folder / "summary.json").write_text('{"measured": 6}')
    Image.new("RGB", (4, 4)).save(folder / "ball.png")
    (folder / "index.html").write_text("the chart's own page")
    text = page("chart")
    assert captions(text) == ["ball.png"] and "<td>measured</td><td>6</td>" in text
    assert [name in text for name in ("KernelDensity", "LineSampling", "WarpedArea")] == [True, True, False]
    assert text.count("<polyline") == 2 and "<script" not in text and len(text) < 20_000
    assert cli.main(["view", "chart", "-o", "chart/index.html"]) == 2
    assert (folder / "index.html").read_text() == "the chart's own page"


def reconstruction(mesh: trimesh.Trimesh, suffix: str) -> None:
    """A folder with a mesh, a linear picture and held-out views."""
    Path("photos/test").mkdir(parents=True)
    Path("photos/config.json").write_text('{"output": "photos", "unknown": ["albedo"]}')
    mesh.export(f"photos/asset{suffix}")
    for i in range(11):
        Image.new("RGB", (4, 4), (i, 0, 0)).save(f"photos/test/r_{i}.png")
    jd.write_image("photos/light.pfm", np.linspace(0, 8, 32 * 3).reshape(4, 8, 3))


def test_a_reconstruction():
    reconstruction(trimesh.creation.box(), ".glb")
    text = page("photos", "-o", "page.html")
    assert captions(text) == ["asset", "light.pfm", *(f"r_{i}.png" for i in range(11))]
    light = np.asarray(Image.open(io.BytesIO(embedded(text, "image/png")[0])))
    assert light.shape == (4, 8, 3) and light[0, 0, 0] == 0 and light[-1, -1].min() >= 254


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_other_meshes_are_converted(suffix):
    box = trimesh.creation.box((1, 2, 3))
    box.export(f"box{suffix}")
    found = trimesh.load(io.BytesIO(models.glb_bytes(Path(f"box{suffix}"))), file_type="glb", force="mesh")
    np.testing.assert_allclose(found.extents, box.extents)
    assert len(found.faces) == 12 and found.visual.material.metallicFactor == 0


def test_the_glb_of_two_files_of_a_name_is_taken():
    reconstruction(trimesh.creation.box(), ".glb")
    trimesh.creation.icosphere(1).export("photos/asset.ply")
    (glb,) = embedded(page("photos"), "model/gltf-binary")
    assert len(trimesh.load(io.BytesIO(glb), file_type="glb", force="mesh").faces) == 12


def test_a_material_of_its_own_is_kept():
    material = trimesh.visual.material.PBRMaterial(name="gold", metallicFactor=1.0)
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    box.export("gold.glb")
    assert models.glb_bytes(Path("gold.glb")) == Path("gold.glb").read_bytes()


def test_a_plain_glb_stays_well_formed():
    jd.save_mesh("ball.glb", BALL)
    data = models.glb_bytes(Path("ball.glb"))
    magic, version, length = struct.unpack_from("<4sII", data)
    size, _ = struct.unpack_from("<II", data, 12)
    document = json.loads(data[20 : 20 + size])
    assert (magic, version, length) == (b"glTF", 2, len(data)) and size % 4 == 0
    assert document["meshes"][0]["primitives"][0]["material"] == 0
    assert data[20 + size :] in Path("ball.glb").read_bytes()


def test_nothing_comes_from_elsewhere():
    """What the page may load is data in itself, by its own policy; the licences of the viewer come with it."""
    optimisation()
    text = page("run")
    own = without_viewer(text)
    assert re.findall(r"""(?:src|href)=["'](?!data:)""", own) == [] and "url(" not in own
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', text).group(1)
    assert policy.startswith("default-src 'none';") and "http" not in policy and "*" not in policy
    for owner in ("Apache License", "three.js authors", "BSD 3-Clause License", "MONOGRID"):
        assert owner in own
    assert len(text) < 1_300_000


def test_an_earlier_page_is_replaced_and_the_run_untouched():
    folder = optimisation(finished=False)
    before = {path for path in folder.path.rglob("*") if path.is_file()}
    first = page("run")
    folder.save_summary({"seconds": 3})
    assert page("run") != first
    assert {path for path in folder.path.rglob("*") if path.is_file()} - before == {
        folder.path / "view.html",
        folder.path / "metrics.json",
    }


def test_open_in_the_browser(monkeypatch, capsys):
    optimisation()
    opened = []
    monkeypatch.setattr(cli.webbrowser, "open", lambda address: opened.append(address))
    assert cli.main(["view", "run", "--open"]) == 0
    assert opened == [Path("run/view.html").resolve().as_uri()]
    captured = capsys.readouterr()
    assert captured.out == "run/view.html\n" and "open the page yourself" in captured.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("nowhere", "nowhere: there is no such folder"),
        ("file.txt", "file.txt: is a file; expected the folder of a run or of a chart"),
        ("empty", "empty: is empty"),
        ("other", "other: is not the folder of a run or of a chart: it has no config.json or chart.json"),
        ("another", "another/config.json: is not the config of a run"),
        ("damaged", "damaged/config.json: is not readable JSON"),
        ("fresh", "fresh: has nothing to show yet"),
        ("run -o folder.html", "output folder.html: is a folder"),
        ("run -o nowhere/page.html", "output nowhere/page.html: folder nowhere does not exist"),
        ("run -o page.png", "output page.png: expected a name that ends with .html or .htm"),
        ("run -o mine.html", "output mine.html: is a file that jaxdr view did not write"),
        ("broken", "broken/meshes/result.glb: the GLB header: the file is cut off after 4 bytes"),
        ("broken_obj", "broken_obj/result.ply is not a readable .ply file"),
        ("run --set a=b", "unrecognized arguments: --set a=b"),
        ("", "the following arguments are required: RUN"),
    ],
)
def test_mistakes_end_with_one_line(workplace, capsys, arguments, message):
    optimisation()
    for name in ("empty", "other", "another", "damaged", "fresh/pictures", "folder.html", "broken_obj"):
        (workplace / name).mkdir(parents=True)
    for name in ("file.txt", "other/notes.txt", "damaged/config.json", "mine.html", "broken_obj/result.ply"):
        (workplace / name).write_text("mine")
    (workplace / "another/config.json").write_text('{"key": 1}')
    shutil.copy("run/config.json", "fresh")
    shutil.copy("run/config.json", "broken_obj")
    shutil.copytree("run", "broken")
    (workplace / "broken/meshes/result.glb").write_bytes(b"glTF")
    assert cli.main(["view", *arguments.split()]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("jaxdr: error: ") and captured.err.count("\n") == 1
    assert message in captured.err
    assert not list(workplace.rglob("view.html")) and (workplace / "mine.html").read_text() == "mine"


def points(picture: str) -> np.ndarray:
    """Places of the first curve."""
    return np.array([place.split(",") for place in re.search(r'points="([^"]+)"', picture).group(1).split()], float)


def test_curves_have_their_places():
    """Powers of ten lie on a straight line; numbers of like size have an axis that is not logarithmic."""
    x = [0.0, 1.0, 2.0, 3.0]
    steep = points(svg(Diagram("loss", "step", [Curve("loss", x, [1.0, 0.1, 0.01, 0.001])])))
    np.testing.assert_allclose(np.diff(steep, axis=0), np.diff(steep, axis=0)[:1].repeat(3, 0), atol=0.11)
    assert steep[0, 1] < steep[-1, 1]  # downwards
    flat = points(svg(Diagram("loss", "step", [Curve("loss", x, [4.0, 3.0, 1.0, 1.0])])))
    np.testing.assert_allclose(np.diff(flat[:, 1])[:2], [np.ptp(flat[:, 1]) / 3, np.ptp(flat[:, 1]) * 2 / 3], atol=0.11)


@pytest.mark.parametrize("values", [[2.0], [0.0, 0.0], [-1.0, 1e-9, 5.0], [1e300, 1e-300]])
def test_curves_of_any_numbers_are_finite(values):
    picture = svg(Diagram("<a>", "step", [Curve("a", [float(i) for i in range(len(values))], values)]))
    assert np.isfinite(points(picture)).all() and "&lt;a&gt;" in picture and "nan" not in picture


def test_long_curves_are_thinned():
    x = np.arange(10_000.0).tolist()
    found = points(svg(Diagram("a", "step", [Curve("a", x, x)])))
    assert len(found) <= 801 and np.ptp(found[:, 0]) == np.ptp(
        points(svg(Diagram("", "", [Curve("", x[::9999], x[:2])])))[:, 0]
    )


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
def test_a_browser_draws_the_mesh(workplace):
    """A red tower, three times as high as wide, stands upright; the page without its viewer has nothing red."""
    tower = trimesh.creation.box((1, 1, 3))
    tower.visual = trimesh.visual.ColorVisuals(tower, vertex_colors=np.tile(RED, (8, 1)))
    reconstruction(tower, ".ply")
    shutil.rmtree("photos/test")
    Path("photos/light.pfm").unlink()
    text = page("photos", "-o", "page.html")
    Path("blind.html").write_text(without_viewer(text))

    def red(pixels):
        return (pixels[..., 0] > 90) & (pixels[..., 1:].max(-1) < 0.6 * pixels[..., 0])

    shown = show(Path("page.html"), 'document.querySelector("model-viewer")?.modelIsVisible', workplace / "profile")
    rows, columns = np.nonzero(red(shown.pixels))
    assert len(rows) > 5_000
    assert 1.8 < (np.ptp(rows) + 1) / (np.ptp(columns) + 1) < 4
    assert shown.errors == []
    assert {address.partition(":")[0] for address in shown.addresses} <= {"file", "data", "blob"}
    blind = show(Path("blind.html"), 'document.readyState === "complete"', workplace / "another")
    assert red(blind.pixels).sum() == 0
