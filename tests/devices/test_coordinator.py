"""The channel between processes listens where the user said, and nowhere else."""

import subprocess
import sys
from pathlib import Path

import pytest

TABLES = [Path("/proc/net/tcp"), Path("/proc/net/tcp6")]
LISTENS = """
import sys
from pathlib import Path
from jaxdr.optimize.processes import start_processes
start_processes(f"127.0.0.1:{sys.argv[1]}", 1, 0)
for table in sys.argv[2:]:
    for line in Path(table).read_text().splitlines()[1:]:
        address, state = line.split()[1], line.split()[3]
        if state == "0A" and int(address.rpartition(":")[2], 16) == int(sys.argv[1]):
            print("listens at", address.rpartition(":")[0])
"""


@pytest.mark.skipif(not TABLES[0].exists(), reason="needs Linux's table of sockets")
def test_the_coordinator_listens_at_the_named_address_alone():
    from tests.devices.test_devices import free_port

    tables = [str(table) for table in TABLES if table.exists()]
    command = [sys.executable, "-c", LISTENS, str(free_port()), *tables]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    found = [line.split()[-1] for line in done.stdout.splitlines() if line.startswith("listens at")]
    assert len(found) == 1 and found[0].endswith("0100007F")  # 127.0.0.1, as IPv4 or mapped to IPv6
