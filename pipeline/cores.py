"""The cores that this process may use."""

import os
from pathlib import Path


def available_cores(group: Path = Path("/sys/fs/cgroup/cpu.max")) -> float:
    """Return the cores available to this process, by affinity and by its cgroup quota."""
    if not hasattr(os, "sched_getaffinity"):  # only Linux has it
        return float(os.cpu_count() or 1)
    cores = float(len(os.sched_getaffinity(0)))
    try:
        quota, period = group.read_text().split()
        return min(cores, int(quota) / int(period))
    except (OSError, ValueError):
        return cores
