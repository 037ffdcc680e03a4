"""README and docs as their readers have them: length, commands, code, links, names, messages, spelling, the site."""

import argparse
import ast
import dataclasses
import html
import inspect
import operator
import os
import re
import shlex
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import PIL.Image
import pytest

import jaxdr as jd
from jaxdr import cli
from jaxdr.chart.config import chart_config
from jaxdr.optimize import config
from jaxdr.optimize.compare import is_comparison, variants
from jaxdr.optimize.reconstruction.config import reconstruct_config
from jaxdr.optimize.recovery.config import is_recovery, recovery_config
from jaxdr.optimize.strict_toml import read_toml
from tests.views.folders import write_nerf

ROOT = Path(__file__).resolve().parents[1]
README, DOCS = ROOT / "README.md", ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
STUDIES = sorted((ROOT / "experiments").glob("*/README.md"))
DATA = sorted((ROOT / "experiments/data").rglob("*.md"))
TEXTS = [README, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *PAGES, *STUDIES, *DATA]
CONFIGS = [*sorted((ROOT / "configs").rglob("*.toml")), ROOT / "experiments/default_choice/chart.toml"]
SCRIPTS = [
    *(ROOT / "examples").glob("*.py"),
    *(ROOT / "experiments").rglob("*.py"),
    *(ROOT / "experiments").rglob("*.sh"),
]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MOST_WORDS = 900

MAIN_JOB = """python3 -m venv .venv && . .venv/bin/activate && pip install -e ".[reconstruct]"
python examples/take_photographs.py runs/photographs
jaxdr reconstruct runs/photographs -o runs/cow --config configs/photographs.toml
"""
TESTS = 'python3 -m venv .venv && . .venv/bin/activate\npip install -e ".[test]" && python -m pytest\n'


def fenced(path: Path, language: str | None = None) -> list[str]:
    """Bodies of the fenced blocks of a page, of one language or of all."""
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", path.read_text(), re.DOTALL | re.MULTILINE)
    return [body for name, body in blocks if language in (None, name)]


def public_names() -> list[str]:
    """What `jaxdr` gives under a name of its own: `from … import name as name`."""
    tree = ast.parse(Path(jd.__file__).read_text())
    imports = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    return [alias.asname for alias in imports if alias.asname == alias.name]


def id_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


# README


def test_the_readme_is_short():
    assert len(README.read_text().split()) <= MOST_WORDS


def test_the_readme_begins_with_the_two_commands():
    assert fenced(README)[:2] == [MAIN_JOB, TESTS]


# Code


def small_scene(name: str) -> jd.Scene:
    """A shape of this name, a lamp and a floor, on 8 x 8 pixels."""
    floor = jd.Shape(jd.shapes.plane(6.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((1, 0, 3), (0, 0, 0), (0, 1, 0)))
    shapes = {name: jd.Shape(jd.shapes.box((0.5, 0.5, 0.5), (0, 0, 0.5))), "floor": floor}
    shapes["lamp"] = jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(10.0))
    camera = jd.Perspective(jd.look_at((0, -4, 3), (0, 0, 0.3), (0, 0, 1)), 30.0, jd.Film(8, 8))
    return jd.Scene(shapes, camera)


def nothing(folder: Path) -> dict:
    return {}


def imports(folder: Path) -> dict:
    return {"jd": jd, "jax": jax, "jnp": jnp}


def with_a_scene(name: str):
    def names(folder: Path) -> dict:
        import json

        scene = small_scene(name)
        vertices = scene.parameters()[f"{name}.vertices"]
        known = {"scene": scene, "key": jax.random.key(0), "vertices": vertices, "json": json}
        poses, images = jnp.stack([scene.camera.to_world] * 2), jnp.zeros((2, 8, 8, 3))
        return imports(folder) | known | {"target": images[0], "poses": poses, "targets": images}

    return names


def with_files(folder: Path) -> dict:
    from jaxdr.scene.formats.mitsuba import bsdfs as mitsuba_bsdfs

    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><default name="width" value="8"/><sensor type="perspective"><film type="hdrfilm">'
        '<integer name="width" value="$width"/><integer name="height" value="8"/></film></sensor>'
        '<shape type="sphere"/></scene>'
    )
    jd.write_image(folder / "wood.png", np.full((4, 4, 3), 0.25))
    PIL.Image.new("L", (4, 4), 64).save(folder / "gloss.png")
    return imports(folder) | vars(mitsuba_bsdfs) | {"mesh": jd.shapes.rectangle()}


def with_photographs(folder: Path) -> dict:
    """A result that the page's code can read."""
    write_nerf(folder / "OUT")
    jd.save_mesh(folder / "OUT/asset.glb", jd.shapes.sphere(1, radius=0.5))
    jd.write_image(folder / "OUT/light.exr", np.ones((4, 8, 3)))
    return {}


# Page -> what its code takes for granted, and whether it compiles gradients.
CODE = {
    "README.md": (nothing, True),
    "docs/choosing.md": (imports, False),
    "docs/devices.md": (with_a_scene("spot"), True),
    "docs/guided_edges.md": (with_a_scene("bunny"), True),
    "docs/how_programs_run.md": (imports, False),
    "docs/index.md": (nothing, True),
    "docs/plan.md": (with_a_scene("spot"), True),
    "docs/quickstart.md": (nothing, False),
    "docs/reconstruct.md": (with_photographs, False),
    "docs/scaling.md": (with_a_scene("spot"), False),
    "docs/scene_files.md": (with_files, False),
    "docs/write_a_bsdf.md": (imports, False),
    "docs/write_a_light.md": (imports, False),
    "docs/write_an_estimator.md": (with_a_scene("spot"), True),
}


def calls_in_tables(page: str) -> list[str]:
    """Code in cells of tables that is Python with a name of ours; … stands for what readers fill in."""
    cells = re.findall(r"(?<=`)[^`|\n]*\bjd\.[^`|\n]*(?=`)", (ROOT / page).read_text())
    return [cell.replace("…", "...") + (" ..." if cell.endswith(":") else "") for cell in cells]


@pytest.mark.parametrize("page", ["docs/coming_from.md", "docs/faq.md"])
def test_calls_that_pages_recommend_are_possible(page):
    """They are Python, their names are public, and functions have the parameters that are named."""
    found = 0
    for text in calls_in_tables(page):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and ast.unparse(node).startswith("jd."):
                called = operator.attrgetter(ast.unparse(node).removeprefix("jd."))(jd)
                assert called is not None, text
            if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("jd."):
                called = operator.attrgetter(ast.unparse(node.func).removeprefix("jd."))(jd)
                named = {keyword.arg: None for keyword in node.keywords if keyword.arg}
                whole = "..." not in ast.unparse(node)
                bind = inspect.signature(called).bind if whole and node.args else inspect.signature(called).bind_partial
                bind(*[None] * len(node.args), **named)
                found += 1
    assert found >= (20 if page == "docs/coming_from.md" else 1)


def test_every_page_with_code_is_run():
    assert sorted(CODE) == sorted(id_of(path) for path in TEXTS if fenced(path, "python"))


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.slow] if slow else []) for page, (_, slow) in CODE.items()]
)
def test_code_runs(page, tmp_path, monkeypatch):
    # What a loop does five hundred times it does twice here.
    code = "\n".join(fenced(ROOT / page, "python")).replace("range(500)", "range(2)")
    names = CODE[page][0](tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(ROOT)
    exec(compile(code, page, "exec"), names)
    if page == "docs/scaling.md":
        assert np.isfinite(names["loss"](names["vertices"], 1, jax.random.key(0)))
    if page == "README.md":
        assert {"ball.vertices", "ball.bsdf.reflectance", "lamp.emitter.radiance"} <= set(names["names"])


@pytest.mark.parametrize("page", TEXTS, ids=id_of)
def test_configs_are_toml(page):
    for block in fenced(page, "toml"):
        assert tomllib.loads(block)


@pytest.mark.parametrize("page", TEXTS, ids=id_of)
def test_commands_have_known_options(page):
    for block in fenced(page, "sh"):
        for line in re.split(r"\n|&&", block.replace("\\\n", " ")):
            words = shlex.split(line, comments=True)
            if words[:1] == ["jaxdr"] and words[1:] != ["--help"]:
                assert cli._parser().parse_args(words[1:])


@pytest.mark.parametrize("page", TEXTS, ids=id_of)
def test_commands_name_what_is_there(page):
    text = page.read_text()
    blocks = "\n".join(fenced(page, "sh"))
    for module in re.findall(r"python -m ((?:experiments|docs)\.[\w.]+)", text):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module
    for file in re.findall(r"(?<![\w/])((?:configs|examples)/\w+\.(?:toml|py))", text):
        assert (ROOT / file).is_file(), file
    for extras in re.findall(r"pip install [^\n]*\[([\w,-]+)\]", text):
        assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"]), extras
    # Commands that are only indented are not found by these tests, and have no button that copies them.
    indented = re.findall(r"^ {4}(?:jaxdr|pip|python) .*", text, re.MULTILINE)
    assert [line for line in indented if line not in blocks] == []


# What a clone has


def test_nothing_outside_of_the_clone_is_named():
    """A path with `..` leads from its file to something in the repository."""
    for path in [*TEXTS, *CONFIGS, *SCRIPTS]:
        for name in re.findall(r"(?<![\w./])(?:\.\./)+[\w./-]*", path.read_text()):
            found = (path.parent / name).resolve()
            assert found.is_relative_to(ROOT) and found.exists(), (id_of(path), name)


@pytest.mark.parametrize("path", CONFIGS, ids=id_of)
def test_every_config_is_valid_and_finds_its_files_in_a_clone(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # so files are found from the config alone
    table = read_toml(path)
    if path.name == "photographs.toml":
        assert reconstruct_config(table, str(path), "photographs", "out")
    elif "scenes" in table:
        assert chart_config(table, path)
    else:
        for run in [variant.table for variant in variants(table, path)] if is_comparison(table) else [table]:
            assert (recovery_config if is_recovery(run) else config.optimize_config)(run, path)


def test_every_extra_is_listed():
    listed = re.findall(r"^\| `([\w-]+)` \|", (DOCS / "install.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(PROJECT["optional-dependencies"])


# Links


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as the site makes them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S), re.MULTILINE)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower()) for heading in headings}


@pytest.mark.parametrize("page", TEXTS, ids=id_of)
def test_relative_links_lead_somewhere(page):
    for target, anchor in re.findall(r"\]\(([^)#\s:]*)(?:#([^)\s]*))?\)", page.read_text()):
        path = page.parent / target if target else page
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), (target, anchor)


@pytest.mark.parametrize("page", [*TEXTS, *CONFIGS], ids=id_of)
def test_no_path_of_a_machine(page):
    assert re.findall(r"(?<![\w.])/(?:home|root|tmp|work|Users)/\S*", page.read_text()) == []


# Names


def test_every_public_name_is_in_the_reference():
    reference = "\n".join(path.read_text() for path in (DOCS / "api").glob("*.md"))
    shown = re.findall(r"^::: jaxdr\.([\w.]+)$", reference, re.MULTILINE)
    for_torch = [name.removeprefix("torch.") for name in shown if name.startswith("torch.")]
    tree = ast.parse(Path(jd.__file__).with_name("torch.py").read_text())
    functions = [node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name[0] != "_"]
    assert sorted(for_torch) == sorted(functions)
    names = [name.rpartition(".")[2] for name in shown if not name.startswith("torch.")]
    assert sorted(names) == sorted(public_names())


@pytest.mark.parametrize("name", public_names())
def test_every_public_name_says_what_it_is(name):
    assert len((inspect.getdoc(getattr(jd, name)) or "").split()) >= 5


RAISES = r"\braise \w+Error|\b(?:as_rgb|rgb|number|vector)\("  # the latter check a parameter


def called_code(value) -> str:
    """What runs when a function or a class is called, as far as it is in its own definition."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(value))).body
    if isinstance(definition, ast.FunctionDef):
        return ast.unparse(definition)
    made = ("__init__", "__check_init__", "__post_init__")
    functions = [node for node in getattr(definition, "body", []) if getattr(node, "name", "") in made]
    return "\n".join(map(ast.unparse, functions))


@pytest.mark.parametrize("name", [name for name in public_names() if not inspect.ismodule(getattr(jd, name))])
def test_every_public_name_says_what_it_raises(name):
    value = getattr(jd, name)
    assert not re.search(RAISES, called_code(value)) or "Raises" in inspect.getdoc(value)


def test_docs_name_nothing_that_is_not_public():
    known = {*public_names(), "__version__"}
    for page in [README, *PAGES]:
        used = set(re.findall(r"\bjd\.(\w+)", page.read_text()))
        assert used <= known, (page.name, used - known)


def test_docs_cite_no_document_that_is_not_here():
    assert [id_of(path) for path in TEXTS if re.search(r"\bDESIGN\b", path.read_text())] == []


def test_commands_have_their_options():
    page = (DOCS / "commands.md").read_text()
    shared = page.split("\n## ")[0]
    parsers = next(a for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction)).choices
    for command, parser in parsers.items():
        if (DOCS / f"{command}.md").exists() and f"\n## jaxdr {command}\n" not in page:
            continue  # it has a page of its own
        section = page.split(f"\n## jaxdr {command}\n")[1].split("\n## ")[0]
        known = {name for action in parser._actions for name in action.option_strings} - {"-h", "--help"}
        common = (
            "`--debug`" if command in ("view", "cameras") else shared
        )  # they compile nothing, and have nothing to set
        assert set(re.findall(r"`(--?[a-z][a-z-]*)", common + section)) - {"--help"} == known, command


def test_every_key_of_a_config_is_listed():
    page = (DOCS / "commands.md").read_text()

    def missing(kind, prefix: str) -> list[str]:
        found = []
        for field in dataclasses.fields(kind):
            name = f"{prefix}{field.name}"
            tables = {"lights": config.Light, "floor": config.Floor}
            made = tables.get(name, type(field.default) if dataclasses.is_dataclass(field.default) else None)
            if name == "target":
                made = config.Target
            found += missing(made, f"{name}.") if made else [] if f"`{name}`" in page else [name]
        return found

    assert missing(config.OptimizeConfig, "") == []


# Messages


def messages(without: tuple[str, ...] = ()) -> list[str]:
    """Constant words of all strings of the library, with … for what is filled in; some files may be left out."""
    found = []
    for path in (file for file in (ROOT / "jaxdr").rglob("*.py") if file.name not in without):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        joined = [node for node in nodes if isinstance(node, ast.JoinedStr)]
        pieces = {id(piece) for node in joined for piece in node.values}
        found += ["".join(p.value if isinstance(p, ast.Constant) else "…" for p in node.values) for node in joined]
        plain = (n for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in pieces)
        found += [node.value for node in plain]
    return found


def listed_messages() -> list[str]:
    """Code in the first column of the tables of docs/errors.md: a row may have several messages of one remedy."""
    first = re.findall(r"^\| (`.*?) \| ", (DOCS / "errors.md").read_text(), re.MULTILINE)
    rows = [row for column in first for row in re.findall(r"`([^`]+)`(?! \(from JAX\))", column)]
    return [row for row in rows if not row.startswith("jd.")]  # the class of a warning


def contains(message: str, row: str) -> bool:
    """Whether the words of a row are in a message, in their order, with anything in the place of ….

    A row that begins with … has few words of its own: it is the whole message.
    """
    if row.startswith("…"):
        return message == row
    return re.search(".*".join(re.escape(part.strip()) for part in row.split("…")), message, re.DOTALL) is not None


def template(node: ast.expr) -> str:
    """A string of the code as docs/errors.md writes it: … for what is filled in."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else "…"
    if isinstance(node, ast.JoinedStr):
        return "".join(template(value) for value in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return template(node.left) + template(node.right)
    return "…"


def refusals() -> list[tuple[str, str]]:
    """Where the library raises, and with which words: `raise`, `require(…, words, …)`, `place.error(…, words)`."""
    found = []
    for path in sorted((ROOT / "jaxdr").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            told: list[ast.expr] = []
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                told = node.exc.args[-1:]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "error":
                told = node.args[-1:]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id.endswith("require"):
                told = node.args[-2:-1]
            for words in map(template, told):
                # What is left of "name: …" are the words of another message, which has its own place.
                if re.search(r"[a-z]{2}", re.sub(r"^([\w. …]+: )+…$", "", words)):
                    found.append((f"{path.relative_to(ROOT)}:{node.lineno}", words))
    return found


def test_every_refusal_is_listed():
    rows, found = listed_messages(), refusals()
    assert len(found) > 500
    unlisted = [place for place in found if not any(contains(place[1], row) for row in rows)]
    assert unlisted == [], "add a row to docs/errors.md: the message, and what to do"


def test_listed_messages_exist():
    texts = messages()
    assert [row for row in listed_messages() if not any(contains(text, row) for text in texts)] == []


def test_refused_derivatives_and_warnings_are_listed():
    rows = listed_messages()
    refusals = [text for text in messages() if text.startswith("render: ") and len(text) > 20]
    printed = ("cli.py", "planned.py", "__init__.py")  # they tell what happens, and refuse nothing
    warnings = [text for text in messages(printed) if text.startswith("jaxdr: ") and len(text) > 60]
    assert len(refusals) > 10 and len(warnings) > 3
    unlisted = [text for text in refusals + warnings if not any(contains(text, row) for row in rows)]
    assert unlisted == []


# Spelling


def test_spelling(tmp_path):
    words = tmp_path / "docstrings.txt"
    with words.open("w") as file:
        for path in sorted((ROOT / "jaxdr").rglob("*.py")) + sorted((ROOT / "examples").glob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node):
                    print(f"{path.name}, {getattr(node, 'name', 'module')}: {ast.get_docstring(node)}", file=file)
    command = [sys.executable, "-m", "codespell_lib", "--toml", str(ROOT / "pyproject.toml")]
    done = subprocess.run([*command, str(words), *map(str, TEXTS)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


# The site


def test_the_site_is_built_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    check_reference("".join(path.read_text() for path in (tmp_path / "site/api").rglob("index.html")))
    theory = (tmp_path / "site/how_it_works/index.html").read_text()
    assert "<math" in theory and "arithmatex" not in theory and "\\frac" not in theory
    assert (tmp_path / "site/experiments/charts/results/environment_penguin.png").is_file()


def check_reference(page: str) -> None:
    """Every public name has its heading, the parameters that it really has, and the first words of its docstring."""
    for name in public_names():
        value = getattr(jd, name)
        found = re.search(rf'<h\d id="jaxdr\.(\w+\.)*{name}".*?(?=<h\d id="jaxdr\.\w|\Z)', page, re.DOTALL)
        assert found, name
        text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", "", found.group())))
        summary = re.sub(r"[`*\s]+", " ", inspect.getdoc(value))[:20].strip()
        assert summary in re.sub(r"[`*\s]+", " ", text), (name, summary)
        if not isinstance(value, type) or issubclass(value, eqx.Module):
            parameters = inspect.signature(value).parameters if callable(value) else []
            assert [p for p in parameters if not re.search(rf"[(,*] ?{p}\b", text)] == [], name


def test_the_tables_by_difficulty_are_those_of_the_results():
    from experiments.charts.difficulty import table, table_of_baselines

    text = (ROOT / "docs/by_difficulty.md").read_text()
    assert table() in text and table_of_baselines() in text
