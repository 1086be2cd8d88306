"""Hosts on one machine: network namespaces on one bridge, each with shared memory of its own.

Needs root, `ip` and `unshare` (see `permitted`). All hosts have the kernel's clock unless a host is
given an offset.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]


@lru_cache(maxsize=1)
def permitted() -> bool:
    """Whether this process may make network namespaces."""
    if os.getuid() != 0 or not shutil.which("ip") or not shutil.which("unshare"):
        return False
    words = [
        "unshare",
        "-n",
        "-m",
        "ip",
        "link",
        "add",
        "eth0",
        "type",
        "veth",
        "peer",
        "name",
        "p0",
    ]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


class Hosts:
    """Hosts by name, from 10.77.0.1 on; a context manager that ends their processes at its exit."""

    def __init__(self, folder: Path, *names: str, ahead_s: Mapping[str, int] | None = None) -> None:
        self._stem, self._folder = f"fv{os.getpid()}", folder
        self.addresses = {name: f"10.77.0.{i + 1}" for i, name in enumerate(names)}
        self._ahead_s = dict(ahead_s or {})  # how far a host's monotonic clock is ahead
        self._running: list[subprocess.Popen[str]] = []

    def __enter__(self) -> "Hosts":
        try:
            self._make()
        except BaseException:  # without entering there is no exit
            self._remove()
            raise
        return self

    def _make(self) -> None:
        switch = f"{self._stem}-switch"
        _ip("netns", "add", switch)
        _ip("-n", switch, "link", "add", "br0", "type", "bridge")
        _ip("-n", switch, "link", "set", "br0", "up")
        for number, (name, address) in enumerate(self.addresses.items()):
            inside, outside = f"{self._stem}-{name}", f"p{number}"
            _ip("netns", "add", inside)
            _ip("link", "add", "eth0", "netns", inside, "type", "veth", "peer", "name", outside,
                "netns", switch)  # fmt: skip
            _ip("-n", switch, "link", "set", outside, "master", "br0", "up")
            _ip("-n", inside, "addr", "add", f"{address}/24", "dev", "eth0")
            _ip("-n", inside, "link", "set", "eth0", "up")
            _ip("-n", inside, "link", "set", "lo", "up")
            self.home(name).mkdir(parents=True, exist_ok=True)

    def _remove(self) -> None:
        for name in [*self.addresses, "switch"]:
            words = ["ip", "netns", "del", f"{self._stem}-{name}"]  # some may not be there yet
            subprocess.run(words, check=False, capture_output=True)

    def __exit__(self, *_: object) -> None:
        for one in self._running:
            if one.poll() is None:
                one.terminate()
        for one in self._running:
            try:
                one.wait(20)
            except subprocess.TimeoutExpired:
                one.kill()
                one.wait()
        self._remove()

    def home(self, name: str) -> Path:
        """Return the folder that replaces the home and /tmp on a host."""
        return self._folder / f"home-{name}"

    def start(self, name: str, *words: str, log: IO[str] | None = None) -> "subprocess.Popen[str]":
        """Start Python with `words` on a host."""
        popen = subprocess.Popen(
            self._command(name, words), text=True, cwd=ROOT, env=self._env(name),
            stdout=log or subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self._running.append(popen)
        return popen

    def run(
        self, name: str, *words: str, timeout_s: float = 120
    ) -> "subprocess.CompletedProcess[str]":
        """Run Python with `words` on a host until it ends."""
        return subprocess.run(
            self._command(name, words), text=True, cwd=ROOT, env=self._env(name),
            capture_output=True, timeout=timeout_s, check=False,
        )  # fmt: skip

    def link(self, name: str, *, up: bool) -> None:
        """Disconnect a host from the network, or connect it again."""
        _ip("-n", f"{self._stem}-{name}", "link", "set", "eth0", "up" if up else "down")

    def traffic(self, name: str) -> tuple[int, int]:
        """Return the bytes that a host has received and sent over its link."""
        command = ["ip", "netns", "exec", f"{self._stem}-{name}", "cat", "/proc/net/dev"]
        shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        fields = next(line for line in shown.splitlines() if "eth0:" in line).split(":")[1].split()
        return int(fields[0]), int(fields[8])

    def _command(self, name: str, words: tuple[str, ...]) -> list[str]:
        script = 'mount -t tmpfs tmpfs /dev/shm && exec "$@"'
        time = ["--time", "--monotonic", str(self._ahead_s[name])] if name in self._ahead_s else []
        return [
            "ip", "netns", "exec", f"{self._stem}-{name}", "unshare", "--mount", *time,
            "sh", "-c", script, "sh", sys.executable, *words,
        ]  # fmt: skip

    def _env(self, name: str) -> dict[str, str]:
        return {
            **os.environ,
            "TMPDIR": str(self.home(name)),
            "HOME": str(self.home(name)),
            "PYTHONPATH": str(ROOT),
        }


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)
