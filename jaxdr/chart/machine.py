"""The machine that a measurement was made on: processor, cores, versions of packages."""

import importlib.metadata
import os
import platform
from pathlib import Path

import jax

PACKAGES = ("jaxdr", "jax", "warp-lang", "embreex", "mitsuba")


def machine() -> dict[str, str | int]:
    """Processor, number of cores that this process may use, device, and versions of installed packages."""
    model = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.exists():
        names = [line.split(":", 1)[1].strip() for line in information.open() if line.startswith("model name")]
        model = names[0] if names else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    found: dict[str, str | int] = {"processor": model, "cores": cores, "device": jax.devices()[0].device_kind}
    found["python"] = platform.python_version()
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
