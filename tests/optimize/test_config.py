"""Configs: what is accepted, and one clear line for everything that isn't."""

import dataclasses
import tomllib
from pathlib import Path

import pytest

from jaxdr.integrators import PathTracer
from jaxdr.optimize.config import OptimizeConfig, Remesh, read_config
from jaxdr.optimize.recovery.config import RecoveryConfig, is_recovery
from jaxdr.optimize.strict_toml import build, split_assignment

MINIMAL = 'output = "runs/x"\n[target]\nshape = "pawn"\n'
CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "run.toml"
        path.write_text(text)
        return path

    return write


def test_remeshing_again_and_again():
    assert list(Remesh(20, vertices=99, every=20, until=70).steps(100)) == [20, 40, 60]
    assert list(Remesh(20, vertices=99, every=40).steps(100)) == [20, 60]
    assert list(Remesh(20, vertices=99).steps(100)) == [20]


def test_defaults_and_values(write):
    config = read_config(
        write(
            MINIMAL
            + "reflectance = [0.1, 0.2, 0.3]\nparameters = { segments = 16 }\n[floor]\nheight = -1\n"
            + "[[lights]]\nradiance = 5\n[[lights]]\nposition = [0, 0, 4]\n"
            + "[[optimizer.remesh]]\niteration = 10\nedge_length = 0.1\n"
        )
    )
    assert config.target.reflectance == (0.1, 0.2, 0.3)
    assert config.target.parameters == {"segments": 16}
    assert config.floor is not None and isinstance(config.floor.height, float)
    assert [light.radiance for light in config.lights] == [5.0, 10.0]
    assert config.optimizer.remesh == (Remesh(10, 0.1),)
    assert config.optimizer.iterations == 300
    assert config.integrator.planned  # the file says nothing about it


def test_is_frozen_and_hashable_where_it_has_no_tables(write):
    config = read_config(write(MINIMAL))
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.seed = 3
    assert config == read_config(write(MINIMAL))


@pytest.mark.parametrize(
    ("override", "read"),
    [
        ("optimizer.lam=50", lambda c: c.optimizer.lam == 50.0),
        ("output=some/where", lambda c: c.output == "some/where"),  # a bare string
        ('output="a b"', lambda c: c.output == "a b"),
        ("cameras.elevation=[1, 2]", lambda c: c.cameras.elevation == (1.0, 2.0)),
        ("floor.size=3", lambda c: c.floor.size == 3.0),  # a table that the file lacks
        ("integrator.boundary=auto", lambda c: c.integrator.build() == PathTracer(2)),
        ("integrator.boundary=none", lambda c: c.integrator.build().boundary is None),
    ],
)
def test_overrides(write, override, read):
    assert read(read_config(write(MINIMAL), [override]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[optimizer]\nlamb = 3", r"optimizer\.lamb: unknown key; did you mean 'lam'\? \(known: iterations, "),
        ("[optimiser]\nlam = 3", r"optimiser: unknown key; did you mean 'optimizer'\?"),
        ('[optimizer]\nlam = "3"', r"optimizer\.lam: expected a number, got '3'"),
        ("[optimizer]\nlam = true", r"optimizer\.lam: expected a number, got True"),
        ("[optimizer]\niterations = 3.5", r"optimizer\.iterations: expected an integer, got 3\.5"),
        ('[optimizer]\nloss = "l3"', r"optimizer\.loss: expected one of 'l1', 'l2', 'two_key_l2', got 'l3'"),
        ("[optimizer]\nviews_per_step = 9", r"optimizer\.views_per_step: must not exceed cameras\.views = 8, got 9"),
        ("[optimizer]\nremesh = 3", r"optimizer\.remesh: expected a list of tables, got 3"),
        ("[[optimizer.remesh]]\niteration = 3", r"optimizer\.remesh\[0\]\.edge_length: give it, or vertices, got 0"),
        (
            "[[optimizer.remesh]]\niteration = 3\nedge_length = 1\nvertices = 9",
            r"optimizer\.remesh\[0\]\.vertices: give this or edge_length, not both, got 9",
        ),
        (
            "[[optimizer.remesh]]\niteration = 3\nvertices = 9\nuntil = 8",
            r"optimizer\.remesh\[0\]\.until: needs every, and must be larger than iteration, got 8",
        ),
        ("[initial]\nvertices = 9", r"initial\.vertices: must be at least 12, got 9"),
        (
            "[[optimizer.remesh]]\niteration = 3\nvertices = 3",
            r"optimizer\.remesh\[0\]\.vertices: must be at least 4, got 3",
        ),
        (
            "[[optimizer.remesh]]\niteration = 3\nedge_length = 0.1\nfield_aligned = true",
            r"optimizer\.remesh\[0\]\.vertices: must be at least 16 with field_aligned, got 0",
        ),
        ("optimizer = 3", r"optimizer: expected a table, got 3"),
        ("[cameras]\nelevation = [1.0]", r"cameras\.elevation: expected a list of 2 numbers, got \[1\.0\]"),
        ("[cameras]\nelevation = [50, 10]", r"cameras\.elevation: must be two increasing angles"),
        ("[cameras]\nviews = 0", r"cameras\.views: must be at least 1, got 0"),
        ("[[lights]]\nradiance = [1, 2]", r"lights\[0\]\.radiance: expected a number or a list of 3 numbers, got"),
        ("lights = []", r"lights: the scene is dark"),
        (
            '[integrator]\nboundary = "Kernel"',
            r"integrator\.boundary: expected one of AllSilhouettes, .*WarpedArea, none, auto, plan, got 'Kernel'",
        ),
        (
            '[integrator]\nboundary = "KernelDensity"\nboundary_options = { radios = 1 }',
            r"integrator\.boundary_options\.radios: KernelDensity has no such",
        ),
        ("[samples]\nimage = 0", r"samples\.image: must be at least 1, got 0"),
        ("seed = -1", r"seed: must be between 0"),
        ("this is not toml", r"is not valid TOML: .*line 1"),
        ("seed = " + "9" * 5000, "is not valid TOML: a whole number of thousands of digits$"),
        ("seed = " + "[" * 3000, "is not valid TOML: it is nested too deeply$"),
    ],
)
def test_mistakes_in_the_file(write, text, message):
    body = MINIMAL + text if text.startswith("[") else f"{text}\n{MINIMAL}"
    with pytest.raises(ValueError, match=rf"run\.toml: {message}"):
        read_config(write(body))


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("", r"target: missing; expected a table"),
        ("[target]", r"target\.shape: give either a shape or a path"),
        ('[target]\nshape = "pawn"\npath = "a.obj"', r"target\.shape: give either a shape or a path"),
        ('[target]\nshape = "prawn"', r"target\.shape: expected one of sphere, .*got 'prawn'"),
        (
            '[target]\nshape = "pawn"\nparameters = { sides = 3 }',
            r"target\.parameters\.sides: pawn has no such parameter",
        ),
        ('[target]\npath = "a.obj"', r"target\.path: expected a mesh file, found none at .*a\.obj"),
    ],
)
def test_mistakes_in_the_target(write, target, message):
    with pytest.raises(ValueError, match=rf"run\.toml: {message}"):
        read_config(write(f'output = "x"\n{target}'))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("optimizer", "--set optimizer: expected key=value"),
        ("=3", "--set =3: expected key=value"),
        ("a..b=3", "--set a..b=3: expected key=value"),
        ("output.x=3", "--set output.x=3: output is not a table in"),
        ("optimizer.lamm=3", "optimizer.lamm: unknown key; did you mean 'lam'?"),
    ],
)
def test_mistakes_in_overrides(write, override, message):
    with pytest.raises(ValueError) as caught:
        read_config(write(MINIMAL), [override])
    assert message in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(ValueError, match=r"nothing\.toml: can't be read \(No such file or directory\)"):
        read_config(tmp_path / "nothing.toml")


def test_values_of_assignments():
    assert split_assignment("a = 1") == ("a", 1)
    assert split_assignment("a=1.5e2") == ("a", 150.0)
    assert split_assignment("a=true") == ("a", True)
    assert split_assignment("a=x=y") == ("a", "x=y")
    assert split_assignment("a=") == ("a", "")


def test_mesh_paths_are_relative_to_the_file_or_the_folder(write, tmp_path, monkeypatch):
    text = 'output = "x"\n[target]\npath = "mesh.obj"\n'
    path = write(text)
    here = tmp_path / "elsewhere"
    here.mkdir()
    monkeypatch.chdir(here)
    (here / "mesh.obj").touch()
    assert read_config(path).target.path == "mesh.obj"
    (tmp_path / "mesh.obj").touch()
    assert read_config(path).target.path == str(tmp_path / "mesh.obj")


# Of charts: see tests/chart; of photographs: see tests/test_examples.py.
SHIPPED = sorted(path for path in CONFIGS.glob("*.toml") if not path.name.startswith(("chart_", "photo")))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_configs_are_valid(path):
    # Built without looking the target's mesh file up, which is not part of the repository.
    table = tomllib.loads(path.read_text())
    kind = RecoveryConfig if is_recovery(table) else OptimizeConfig
    assert build(kind, table, path.name).output.startswith("runs/")
