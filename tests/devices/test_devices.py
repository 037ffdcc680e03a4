"""Many devices: the same results, and work that is divided. Eight virtual devices need a process of their own."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from jaxdr.optimize.devices import Division, batches, chosen_devices, divide

ROOT = Path(__file__).parents[2]
SMALL = [
    "optimizer.views_per_step=2",
    "cameras.views=3",
    "cameras.resolution=12",
    "integrator.boundary=none",
    "samples.target=4",
    "samples.image=2",
    "samples.gradient=2",
    "samples.pictures=1",
    "report.chamfer_samples=200",
    "report.checkpoint=1",
]


@pytest.fixture(scope="module")
def eight():
    command = [sys.executable, "-m", "tests.devices.on_eight"]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    return json.loads(done.stdout.splitlines()[-1])


def environment() -> dict:
    """Compiled as users do: XLA's lower level of optimisation rounds batches of one size differently from others."""
    return {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"} | {
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": str(ROOT),
    }


def test_shard_map_with_all_checks(eight):
    assert eight["devices"] == 8
    for ours, expected in zip(*eight["shard_map"], strict=True):
        np.testing.assert_allclose(ours, expected, rtol=2e-5, atol=1e-7)


def test_images_do_not_depend_on_the_number_of_devices(eight):
    """Bit for bit: images one by one, by shard_map over two devices, as a batch on one and as one on eight."""
    assert eight["same bits"] == [True, True, True]


def test_a_sharded_batch_is_divided(eight):
    """As many rays as on one device, in eight times as many queries."""
    (few, rays), (many, divided) = eight["rays"]
    assert rays > 0 and divided == rays and many == 8 * few


def test_steps_do_not_depend_on_the_number_of_devices(eight):
    """Uneven views, too: five of them. XLA's programs for one device round differently from those for several."""
    several, one = eight["steps alike"]
    assert several == 0.0
    assert one < 1e-5 * eight["size of a step"]


def test_shares_of_a_view_are_averaged(eight):
    shares, mean, expected = eight["shares"]
    assert shares == 8
    np.testing.assert_allclose(mean, expected, rtol=1e-6)


@pytest.mark.parametrize("views", [1, 2, 3, 4, 5, 8, 100])
@pytest.mark.parametrize("devices", [1, 2, 3, 6, 8])
def test_all_devices_work(views, devices):
    rows, shares = division = divide(views, devices, spp=16)
    assert rows * shares == devices
    rounds = len(batches(range(views), rows))
    assert rounds * division.samples(16) <= views * -(-16 // devices)  # all devices on one view after the other
    if views % devices == 0:
        assert shares == 1


def test_shares_have_a_sample_at_least():
    assert Division(1, 8).samples(2) == 1
    assert divide(4, 8, spp=1) == (8, 1)


def test_batches_are_filled_up():
    assert batches("abcde", 2) == [["a", "b"], ["c", "d"], ["e", "e"]]


def test_too_many_devices():
    with pytest.raises(ValueError, match="devices: 4096 asked for, but there are only"):
        chosen_devices(4096)


class Process:
    """One process of a run of two."""

    def __init__(self, output: Path, port: int, number: int, settings: list[str], *options: str):
        command = [sys.executable, "-m", "jaxdr", "optimize", "configs/quickstart.toml", "--no-cache", *options]
        command += ["--coordinator", f"127.0.0.1:{port}", "--processes", "2", "--process", str(number)]
        self.log = output.parent / f"{output.name}_{number}.log"
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(
                [*command, *with_settings(output, settings)], cwd=ROOT, env=environment(), stdout=log, stderr=log
            )

    def said(self) -> str:
        return self.log.read_text()


def with_settings(output: Path, settings: list[str]) -> list[str]:
    return [word for setting in (f"output={output}", *SMALL, *settings) for word in ("--set", setting)]


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def state(output: Path) -> dict:
    with np.load(output / "checkpoint.npz") as saved:
        return {name: saved[name] for name in saved.files if name != "seconds"}


def steps_done(output: Path) -> int:
    return int(state(output)["step"]) if (output / "checkpoint.npz").exists() else 0


@pytest.fixture(scope="module")
def two_processes(tmp_path_factory):
    output, port = tmp_path_factory.mktemp("processes") / "run", free_port()
    both = [Process(output, port, number, ["optimizer.iterations=2"]) for number in (0, 1)]
    for one in both:
        assert one.process.wait(300) == 0, one.said()[-4000:]
    return output


def test_two_processes_are_as_two_devices(two_processes, tmp_path):
    """Bit for bit, and one of them writes."""
    output = tmp_path / "run"
    command = [sys.executable, "-m", "jaxdr", "optimize", "configs/quickstart.toml", "--no-cache", "--devices", "2"]
    settings = with_settings(output, ["optimizer.iterations=2"])
    subprocess.run([*command, *settings], cwd=ROOT, env=environment(), check=True, capture_output=True)
    ours, expected = state(two_processes), state(output)
    assert ours.keys() == expected.keys()
    for name in expected:
        np.testing.assert_array_equal(ours[name], expected[name], err_msg=name)
    lines = (two_processes / "metrics.csv").read_text().splitlines()
    assert [line.partition(",")[0] for line in lines] == ["iteration", "1", "2"]


def test_the_writer_s_mistakes_end_all(two_processes):
    port = free_port()
    both = [Process(two_processes, port, number, ["optimizer.iterations=2"]) for number in (0, 1)]
    for one in both:
        assert one.process.wait(300) == 2
        assert "already holds results; give --resume or --overwrite" in one.said()


@pytest.mark.slow
@pytest.mark.parametrize("killed", [0, 1])
def test_a_killed_process_ends_the_other(tmp_path, killed):
    """Within a minute, with the checkpoint and how to go on; and the run goes on from there."""
    output, port = tmp_path / "run", free_port()
    both = [Process(output, port, number, ["optimizer.iterations=5000"]) for number in (0, 1)]
    deadline = time.monotonic() + 300
    while steps_done(output) < 1 and time.monotonic() < deadline:
        time.sleep(0.5)
    both[killed].process.send_signal(signal.SIGKILL)
    other = both[1 - killed]
    assert other.process.wait(60) == 1
    assert re.search(
        rf"process {1 - killed} of 2 has lost another one .* start all processes again with --resume", other.said()
    )
    done = steps_done(output)
    assert done > 0

    port = free_port()
    both = [Process(output, port, number, ["optimizer.iterations=5000"], "--resume") for number in (0, 1)]
    while steps_done(output) <= done and time.monotonic() < deadline + 300:
        time.sleep(0.5)
    for one in both:
        one.process.kill()
        one.process.wait()
    assert steps_done(output) > done
