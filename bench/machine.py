"""Where a figure was measured: processor, system, library versions and the commit of the code."""

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from pipeline.version import revision

LIBRARIES = ("eclipse-zenoh", "numpy", "onnxruntime", "opencv-python-headless", "filterpy")


def facts(libraries: tuple[str, ...] = LIBRARIES) -> dict[str, Any]:
    """Return the origin for a result file, JSON-ready; absent libraries are left out."""
    commit, changed = revision()
    return {
        "machine": {
            "cpu": cpu_name(),
            "cores": psutil.cpu_count() or 0,
            "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
            "kernel": platform.release(),
            "load_1min": round(psutil.getloadavg()[0], 2),
        },
        "python": platform.python_version(),
        "libraries": versions(libraries),
        "commit": commit,
        "dirty": changed,
    }


def cpu_name(listing: Path = Path("/proc/cpuinfo")) -> str:
    """Return the processor's name from Linux's listing, else its architecture."""
    if listing.is_file():
        for line in listing.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()


def versions(libraries: tuple[str, ...]) -> dict[str, str]:
    """Return installed versions by distribution name."""
    found = {}
    for name in libraries:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
