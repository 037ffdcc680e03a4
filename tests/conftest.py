"""Shapes and dtypes of every public signature are checked by beartype, in the tests only."""

import gc
import os
import shutil
import signal
from pathlib import Path

import jax
import pytest
from jaxtyping import install_import_hook

import tests.type_checker  # noqa: F401  the hook names it in a string

# Most of the time of a test is XLA's: programs are compiled fast here, not compiled to be fast. Each version of XLA has
# flags of its own, and aborts at unknown ones. They are read when the first array is made, in child processes as well.
# Not level 0: in 0.10.2 `(a - b != 0).any(-1)` for vectors a, b then is False now and then where it should be True.
if jax.__version__.startswith("0.10."):
    quick = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=1"
    quick += " --xla_backend_extra_options=xla_cpu_disable_loop_unrolling"  # a third of the compiler's time
    os.environ["XLA_FLAGS"] = f"{quick} {os.environ.get('XLA_FLAGS', '')}"

# Tracing makes many objects that live on. At Python's own threshold a fifth of its time goes to looking for others.
gc.set_threshold(20_000, 10, 10)

# A run in the background inherits SIGINT ignored; the tests of Ctrl-C are about a program in the foreground.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).parents[1]

# Before the first import of the package: the hook rewrites modules as they are loaded. Annotations in the Warp modules
# are Warp's own language. A package's own name would stand for all that is in it.
WARP = ("jaxdr/geometry/queries/warp/", "jaxdr/geometry/queries/embree/", "jaxdr/optimize/warp_")
install_import_hook(
    [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in (ROOT / "jaxdr").rglob("*.py")
        if path.name != "__init__.py" and not path.relative_to(ROOT).as_posix().startswith(WARP)
    ],
    "tests.type_checker.check",
)


def pytest_configure(config):
    """Compiled programs are kept in the user's cache folder (`pytest --cache-clear` empties it); all runs share it."""
    from jaxdr.kernels import machine
    from jaxdr.program_cache import keep_programs, user_folder

    machine.FLAGS += " -O1"  # kernels, too, are compiled fast
    folder = user_folder() / "tests"
    if config.getoption("cacheclear", False) and not hasattr(config, "workerinput"):
        shutil.rmtree(folder, ignore_errors=True)
    try:
        keep_programs(folder)
    except OSError as problem:
        config.issue_config_time_warning(pytest.PytestConfigWarning(f"no program is kept: {problem}"), stacklevel=1)


FULL = ROOT / "tests/full.txt"


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(config, items):
    """Mark the tests that `tests/full.txt` names by their id, or by that of a test with any parameters."""
    lines = [line for line in FULL.read_text().splitlines() if line and not line.startswith("#")]
    named = {line: False for line in lines}
    for item in items:
        for name in (item.nodeid, item.nodeid.partition("[")[0]):
            if name in named:
                named[name] = True
                if not item.get_closest_marker("slow"):
                    item.add_marker("full")
    whole = {item.nodeid.partition("::")[0] for item in items} if not any("::" in word for word in config.args) else ()
    missing = [name for name, found in named.items() if not found and name.partition("::")[0] in whole]
    if missing:
        raise pytest.UsageError(f"tests/full.txt names tests that are not there: {', '.join(missing)}")


MAPPINGS = Path("/proc/self/maps")
MOST_MAPPINGS = 30_000  # Linux gives a process 65530, and XLA's compiler crashes without


@pytest.fixture(autouse=True, scope="module")
def room_for_programs():
    """Every compiled program maps memory: forget those of earlier modules before there is no room for more."""
    yield
    if MAPPINGS.exists():
        with MAPPINGS.open() as lines:
            crowded = sum(1 for _ in lines) > MOST_MAPPINGS
        if crowded:
            jax.clear_caches()
            gc.collect()
