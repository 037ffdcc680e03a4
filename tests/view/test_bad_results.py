"""Folders of results that are damaged or hostile: links are not shown, and errors name the file and the place."""

import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from jaxdr.view.curves import svg
from jaxdr.view.models import glb_bytes
from jaxdr.view.tables import Curve, Diagram, metrics_diagrams
from jaxdr.view.write import write_page
from jaxdr.web_page import content_policy

SECRET = b"a secret of the machine"


@pytest.fixture
def run(tmp_path) -> Path:
    folder = tmp_path / "run"
    for name in ("pictures", "meshes", "test"):
        (folder / name).mkdir(parents=True)
    (folder / "config.json").write_text('{"output": "run", "target": {}}')
    (folder / "metrics.json").write_text('{"seconds": 1.5}')
    (folder / "metrics.csv").write_text("iteration,loss\n1,0.5\n2,0.25\n")
    Image.new("RGB", (4, 4)).save(folder / "pictures/00000.png")
    trimesh.creation.box().export(folder / "meshes/00000.glb")
    return folder


def outside(folder: Path) -> Path:
    """A folder elsewhere, with private files of every kind."""
    place = folder.parent / "private"
    (place / "pictures").mkdir(parents=True)
    Image.new("RGB", (5, 5), (1, 2, 3)).save(place / "photograph.png")
    Image.new("RGB", (5, 5), (1, 2, 3)).save(place / "pictures/00007.png")
    trimesh.creation.icosphere(1).export(place / "ball.glb")
    (place / "text").write_bytes(SECRET)
    return place


def test_links_are_left_out_and_the_page_says_so(run):
    place = outside(run)
    (run / "pictures/00001.png").symlink_to(place / "text")
    (run / "pictures/00002.png").symlink_to(place / "photograph.png")
    (run / "pictures/00003.png").symlink_to(place / "nowhere")
    (run / "meshes/result.glb").symlink_to(place / "ball.glb")
    os.mkfifo(run / "test/r_0.png")
    text = write_page(run).read_text()
    left_out = ["meshes/result.glb", "test/r_0.png", *(f"pictures/0000{i}.png" for i in (1, 2, 3))]
    assert all(name in text.partition("Left out, because they are links")[2].partition("</p>")[0] for name in left_out)
    assert text.count("<figure>") == 2 and "step 1" not in text


@pytest.mark.parametrize("name", ["pictures", "meshes", "test"])
def test_linked_folders_are_left_out(run, name):
    place = outside(run)
    for file in (run / name).iterdir():
        file.unlink()
    (run / name).rmdir()
    (run / name).symlink_to(place / "pictures")
    text = write_page(run).read_text()
    assert f"Left out, because they are links or no regular files: {name}." in text and "00007" not in text


@pytest.mark.parametrize("name", ["config.json", "metrics.json", "metrics.csv"])
def test_linked_tables_are_refused(run, name):
    (run / name).rename(run.parent / "elsewhere")
    (run / name).symlink_to(run.parent / "elsewhere")
    with pytest.raises(ValueError, match=f"{name}: is a link or no regular file"):
        write_page(run)


def test_the_folder_itself_may_be_a_link(run):
    link = run.parent / "link"
    link.symlink_to(run)
    assert "Left out" not in write_page(link).read_text()


def test_nothing_but_links(run):
    for name in ("metrics.json", "metrics.csv", "meshes/00000.glb", "pictures/00000.png"):
        (run / name).unlink()
    (run / "pictures/00000.png").symlink_to(outside(run) / "photograph.png")
    with pytest.raises(ValueError, match="has nothing to show but links"):
        write_page(run)


def test_an_output_that_is_a_link_or_a_pipe_is_refused(run):
    written = write_page(run)
    written.rename(run.parent / "page.html")
    written.symlink_to(run.parent / "page.html")
    os.mkfifo(run.parent / "pipe.html")
    for path in (written, run.parent / "pipe.html"):
        with pytest.raises(ValueError, match="is a file that jaxdr view did not write"):
            write_page(run, path)


@pytest.mark.parametrize("name", ["pictures/00000.png", "photograph.jpg", "turn.gif"])
@pytest.mark.parametrize("content", [SECRET, b"", b"\x89PNG\r\n\x1a\n" + SECRET, b"<svg xmlns='x'/>"])
def test_only_pictures_are_shown_as_pictures(run, name, content):
    (run / name).write_bytes(content)
    with pytest.raises(ValueError, match=f"{name}: can't be shown"):
        write_page(run)


def test_a_picture_of_another_kind_and_a_cut_one(run):
    path = run / "pictures/00000.png"
    Image.new("RGB", (9, 9)).save(path, format="GIF")
    with pytest.raises(ValueError, match=r"00000\.png: can't be shown \(not a readable PNG file"):
        write_page(run)
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ValueError, match=r"00000\.png: can't be shown"):
        write_page(run)


def test_a_mesh_brings_no_other_file_into_the_page(run):
    """Pictures that materials name may be private."""
    place = outside(run)
    (run / "a.mtl").write_text(f"newmtl m\nmap_Kd {place / 'photograph.png'}\n")
    (run / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n")
    (run / "b.ply").write_text(
        f"ply\nformat ascii 1.0\ncomment TextureFile {place / 'photograph.png'}\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    for name in ("a.obj", "b.ply"):
        data = glb_bytes(run / name)
        document = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
        assert "images" not in document and [m["name"] for m in document["materials"]] == ["plain"]


def test_colours_of_a_mesh_are_kept_and_checked(run):
    text = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 {}\nf 1 2 3\n"
    (run / "a.obj").write_text(text.format("0.5"))
    data = glb_bytes(run / "a.obj")
    document = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    assert "COLOR_0" in document["meshes"][0]["primitives"][0]["attributes"]
    (run / "a.obj").write_text(text.format("7"))
    with pytest.raises(ValueError, match=r"a\.obj: its colours go from 0 to 7"):
        write_page(run)


def glb(text: bytes) -> bytes:
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text


CHART = "scene,estimator,seconds,rmse\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("config.json", "[1]", "config.json: is not the config of a run"),
        ("config.json", b"{\xff}", "config.json: is not readable JSON"),
        ("config.json", '{"target": ' + "[" * 100_000, "config.json: is not readable JSON"),
        ("metrics.json", "[1, 2]", "metrics.json: expected numbers by name, got [1, 2]"),
        ("metrics.json", '{"a": NaN}', "metrics.json: is not readable JSON (NaN is no number of JSON)"),
        ("metrics.json", '{"a": ' + "9" * 5000 + "}", "metrics.json: is not readable JSON"),
        ("metrics.csv", "iteration,loss,x\n1,2,3,4\n2,3,4,5\n", "metrics.csv: line 2: has 4 cells, the header has 3"),
        ("metrics.csv", "iteration,loss\n1\n2,3\n", "metrics.csv: line 2: has 1 cells, the header has 2"),
        ("metrics.csv", "iteration,loss,loss\n1,2,3\n", "metrics.csv: has two columns called 'loss'"),
        ("metrics.csv", b"iteration,loss\n1,\xff\n", "metrics.csv: can't be read as text in UTF-8"),
        ("metrics.csv", "iteration,loss\n1," + "9" * 200_000, "metrics.csv: is no table of comma-separated values"),
        ("metrics.csv", 'iteration,loss\n1,"2\n3,4\n', "metrics.csv: is no table of comma-separated values"),
        ("rows.csv", "estimator,seconds,rmse\ne,1,1\n", "rows.csv: has no column 'scene'"),
        ("rows.csv", CHART + "a,b,1,2,3\n", "rows.csv: line 2: has 5 cells, the header has 4"),
        ("meshes/00000.glb", glb(b"[1] "), "00000.glb: the JSON: must be an object"),
        ("meshes/00000.glb", glb(b"{}  "), "00000.glb: asset: "),
        ("asset.ply", "ply\nelement vertex 99999999999\n", "asset.ply is not a readable .ply file"),
        ("asset.obj", "v 0 0 nan\nf 1 1 1\n", "asset.obj is not a readable .obj file"),
        ("light.pfm", "PF\n99999 99999\n-1.0\n", "light.pfm: "),
    ],
)
def test_damaged_files_are_one_error(run, name, content, message):
    (run / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError) as caught:
        write_page(run)
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert not (run / "view.html").exists()


def test_the_config_of_a_chart_is_read(run):
    (run / "config.json").rename(run / "chart.json")
    (run / "chart.json").write_text("[]")
    with pytest.raises(ValueError, match=r"chart\.json: is not the config of a run"):
        write_page(run)


@pytest.mark.parametrize("text", ["", "\n", "iteration,loss\n", "iteration,loss"])
def test_tables_without_numbers(run, text):
    (run / "metrics.csv").write_text(text)
    assert 'class="diagram"' not in write_page(run).read_text()


def test_numbers_that_a_diagram_cannot_show_are_told(run):
    (run / "metrics.csv").write_text("iteration,loss\n1,1e308\n2,-1e308\n3,nan\n4,inf\n5,1\n6,2\n7,\n")
    (diagram,) = metrics_diagrams(run / "metrics.csv")
    assert diagram == Diagram("loss (4 not finite or too large)", "iteration", [Curve("loss", [5.0, 6.0], [1.0, 2.0])])


def test_characters_that_are_none_do_not_end_the_page(run):
    (run / "metrics.json").write_text('{"device": "\\ud800 \\u0000"}')
    (run / "metrics.csv").write_text("iteration,lo\0ss\n1,2\n2,3\n")
    assert "<td>? \0</td>" in write_page(run).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "values", [[0.0, 5e-324], [5e-324, 1e300], [1e300, 2e300], [-1e300, 1e300], [1.0, 1.0 + 2e-16], [1e-323, 1e-300]]
)
def test_curves_of_extreme_numbers(values):
    picture = svg(Diagram("a", "step", [Curve("a", values, values)], logarithmic_x=True))
    assert "nan" not in picture and "inf" not in picture


def test_pages_load_nothing():
    for viewer in (False, True):
        policy = content_policy(viewer)
        assert "default-src 'none'; base-uri 'none'; form-action 'none'" in policy
        assert "http:" not in policy and "https:" not in policy and "*" not in policy
        assert ("script-src" in policy) == viewer


def test_only_a_page_with_meshes_may_run_scripts(run):
    assert content_policy(viewer=True) in write_page(run).read_text()
    (run / "meshes/00000.glb").unlink()
    assert content_policy() in write_page(run).read_text()
