"""The notebooks of docs/notebooks: what is stored in them, and that they still do what it says."""

import ast
import base64
import re
import subprocess
import sys
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import nbformat
import pytest
from PIL import Image

from docs.tools.notebook_pages import page_of
from docs.tools.notebooks import NAMES, cleaned, executed
from tests.test_documentation import public_names

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs/notebooks"
MOST_BYTES, MOST_WORDS_OF_A_CELL, MOST_LINES = 450_000, 90, 30
MACHINE = re.compile(r"(?<![\w.:/])/(?:home|root|tmp|work|Users|var|opt)/|[A-Z]:\\\\|localhost|127\.0\.0\.1")
PICTURES = ("image/png", "image/gif")


def read(name: str) -> nbformat.NotebookNode:
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def code(notebook) -> list:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def python(cell) -> str:
    """The Python of a cell, without commands of the shell and magics."""
    return "\n".join("" if line.startswith(("!", "%")) else line for line in cell.source.splitlines())


def printed(notebook) -> str:
    """What all cells print."""
    return "".join(output.text for cell in code(notebook) for output in cell.outputs if output.output_type == "stream")


def numbers(text: str, words: str) -> list[float]:
    """The numbers behind words."""
    (line,) = (line for line in text.splitlines() if words in line)
    return [float(number) for number in re.findall(r"\d+\.?\d*", line.partition(words)[2])]


def test_all_are_listed():
    assert sorted(NAMES) == sorted(path.stem for path in FOLDER.glob("*.ipynb"))
    page, site = (ROOT / "docs/notebooks.md").read_text(), (ROOT / "mkdocs.yml").read_text()
    for name in NAMES:
        assert f"(notebooks/{name}.ipynb)" in page and f": notebooks/{name}.md\n" in site


@pytest.mark.parametrize("name", NAMES)
def test_it_is_executed_from_top_to_bottom_without_an_error(name):
    notebook = read(name)
    nbformat.validate(notebook)
    cells = code(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    kinds = {output.output_type for cell in cells for output in cell.outputs}
    assert kinds <= {"stream", "display_data", "execute_result"}
    assert {o.name for cell in cells for o in cell.outputs if o.output_type == "stream"} <= {"stdout"}


@pytest.mark.parametrize("name", NAMES)
def test_what_is_stored_is_clean(name):
    """Executing it again changes what it found only."""
    text = (FOLDER / f"{name}.ipynb").read_text()
    assert len(text) < MOST_BYTES
    assert MACHINE.findall(text) == []
    assert nbformat.writes(cleaned(read(name))) == text.rstrip("\n")


@pytest.mark.parametrize("name", NAMES)
def test_it_has_pictures(name):
    outputs = [output for cell in code(read(name)) for output in cell.outputs if "data" in output]
    pictures = [(output, kind) for output in outputs for kind in PICTURES if kind in output.data]
    for output, kind in pictures:
        width, height = Image.open(BytesIO(base64.b64decode(output.data[kind]))).size
        assert max(output.metadata.get(kind, {}).get("width", width), height) >= 200
    assert len(pictures) >= 4


@pytest.mark.parametrize("name", NAMES)
def test_words_come_before_code_and_cells_are_short(name):
    cells = read(name).cells
    assert cells[0].source.startswith("# ")
    for before, cell in pairwise(cells):
        assert cell.cell_type == "markdown" or before.cell_type == "markdown" or len(before.source.splitlines()) < 20
        if cell.cell_type == "code":
            assert len(cell.source.splitlines()) <= MOST_LINES
        else:
            assert len(cell.source.split()) <= MOST_WORDS_OF_A_CELL


@pytest.mark.parametrize("name", NAMES)
def test_it_uses_public_names_only(name):
    for cell in code(read(name)):
        for node in ast.walk(ast.parse(python(cell))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "jd":
                assert node.attr in public_names()
            if isinstance(node, ast.ImportFrom):
                assert not (node.module or "").startswith("jaxdr")
            if isinstance(node, ast.Import):
                assert all(not alias.name.startswith("jaxdr.") for alias in node.names)


@pytest.mark.parametrize("name", NAMES)
def test_its_links_lead_somewhere(name):
    for cell in read(name).cells:
        if cell.cell_type == "markdown":
            for target in re.findall(r"\]\(([^)#\s]+)", cell.source):
                assert (FOLDER / target).exists(), target


def test_spelling_and_style(tmp_path):
    for name in NAMES:
        cells = read(name).cells
        words = "\n\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
        (tmp_path / f"{name}.md").write_text(words + "\n")
    command = [sys.executable, "-m", "codespell_lib", "--toml", str(ROOT / "pyproject.toml"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_a_page_of_the_site():
    picture = base64.b64encode(b"bytes of a picture").decode()
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": ["ratio ", "1.0\n"]},
        {"output_type": "display_data", "data": {"image/png": picture}},
        {"output_type": "display_data", "data": {"image/gif": picture}, "metadata": {"image/gif": {"width": 256}}},
        {"output_type": "execute_result", "data": {"text/html": ["<b>table</b>"], "text/plain": ["x"]}},
    ]
    cells = [
        {"cell_type": "markdown", "source": ["# Title\n", "\n", "Words."]},
        {"cell_type": "code", "source": "x = 1", "outputs": outputs},
    ]
    page, pictures = page_of({"cells": cells}, "name")
    assert pictures == {"1.png": b"bytes of a picture", "2.gif": b"bytes of a picture"}
    after = page.split("``` python\nx = 1\n```\n\n")[1]
    shown = "![Output of the cell above](name/1.png)", '![Output of the cell above](name/2.gif){ width="256" }'
    assert after == "\n\n".join(["``` text\nratio 1.0\n```", *shown, "<b>table</b>\n"])


# They are executed as a reader does it, from a clone, and their key numbers are looked at


@pytest.fixture
def run(tmp_path):
    """A function that executes a notebook in a copy of its folder, and returns what it prints."""
    folder = tmp_path / "docs/notebooks"
    folder.mkdir(parents=True)
    for name in ("examples", "configs"):
        (tmp_path / name).symlink_to(ROOT / name)
    return lambda name: printed(executed(read(name), folder))


@pytest.mark.slow
def test_first_gradient(run):
    text = run("first_gradient")
    ratio, error = numbers(text, "jvp / finite differences:")
    assert abs(ratio - 1) < 4 * error < 0.2
    assert abs(numbers(text, "interior / finite differences:")[0] - 1) > 0.3
    assert "the right" in text


@pytest.mark.slow
def test_shape_from_views(run):
    before, after = numbers(run("shape_from_views"), "Chamfer distance:")
    assert after < before / 4


@pytest.mark.slow
def test_photographs_to_asset(run):
    text = run("photographs_to_asset")
    assert numbers(text, "PSNR of held-out photographs:")[0] > 25
    assert numbers(text, "overlap of masks:")[0] > 0.95


@pytest.mark.slow
def test_speed_against_accuracy(run):
    text = run("speed_against_accuracy")
    share, error = numbers(text, "finite differences / reference:")
    assert abs(share - 1) < 4 * error < 0.2
    assert "best here: GuidedEdges" in text
