"""A Python process with mounts of its own: small shared memory, a small disk."""

import os
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@lru_cache(maxsize=1)
def permitted() -> bool:
    """Return whether a process may have mounts of its own."""
    if os.getuid() != 0:
        return False
    command = ["unshare", "-m", "mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", "/dev/shm"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def with_small_mounts(
    sizes: Mapping[Path | str, str], *words: str, timeout_s: float = 180, **environment: str
) -> "subprocess.CompletedProcess[str]":
    """Run Python with `words`, a tmpfs of so many bytes on each folder; skip where forbidden."""
    if not permitted():
        pytest.skip("mount namespaces are not permitted here")
    mounts = [f"mount -t tmpfs -o size={size} tmpfs '{folder}'" for folder, size in sizes.items()]
    script = " && ".join([*mounts, 'exec "$@"'])
    return subprocess.run(
        ["unshare", "-m", "sh", "-c", script, "sh", sys.executable, *words],
        capture_output=True, text=True, timeout=timeout_s, check=False, cwd=ROOT,
        env={**os.environ, **environment},
    )  # fmt: skip
