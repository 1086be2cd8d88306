"""Virtual boards at this kernel's virtual USB ports: over USB/IP, and as a gadget."""

import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.usb.link import attached
from drivers.virtual_board import VirtualBackend, VirtualBoardSettings
from drivers.virtual_board.gadget_configuration import CONFIG_FS
from drivers.virtual_board.usbip import detach, free_port, serve
from tests.conftest import ROOT

FOUND_S = 60.0  # an emulated processor may be slow


def until(true: Callable[[], bool]) -> None:
    """Wait until the kernel has noticed something."""
    deadline_s = time.monotonic() + FOUND_S
    while not true():
        assert time.monotonic() < deadline_s, "the kernel did not notice"
        time.sleep(0.1)  # each look costs an emulated processor as much


def attached_boards() -> int:
    """Return how many boards the kernel has found."""
    return len(attached())


class Usbip:
    """Attaches boards over USB/IP, which this process serves."""

    @contextmanager
    def attached(self, settings: dict[str, Any]) -> Iterator[None]:
        """Attach a board, and detach it."""
        board = VirtualBackend(VirtualBoardSettings(**settings)).board
        port = free_port()
        thread = threading.Thread(target=serve, args=(board,), kwargs={"port": port})
        thread.start()
        try:
            yield
        finally:
            detach(port)
            thread.join(FOUND_S)
            assert not thread.is_alive()

    def close(self) -> None:
        """Nothing is held."""


class Gadgets:
    """Attaches boards as gadgets, each of which is the program in a process of its own."""

    def __init__(self) -> None:
        self._programs = subprocess.Popen(
            [sys.executable, "-m", "tests.drivers.usb.gadgets"],
            cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()
        # else it would take the processor from tests whose requests have a limit of a second
        assert self._answer() == "ready"

    @contextmanager
    def attached(self, settings: dict[str, Any]) -> Iterator[None]:
        """Start the program, and terminate it: nothing is left of what it made."""
        self._send(_options(settings))
        try:
            yield
        finally:
            self._send([])
            assert self._answer() == "ended with 0"
        assert not left_by_gadgets()

    def close(self) -> None:
        """End the process that starts programs."""
        self._programs.communicate(timeout=FOUND_S)

    def _answer(self) -> str:
        return self._lines.get(timeout=FOUND_S)

    def _listen(self) -> None:
        assert self._programs.stdout is not None
        for line in self._programs.stdout:
            self._lines.put(line.strip())
        self._lines.put("")

    def _send(self, options: list[str]) -> None:
        assert self._programs.stdin is not None
        print(json.dumps(options), file=self._programs.stdin, flush=True)


VIRTUALLY: dict[str, Callable[[], Usbip | Gadgets]] = {"usbip": Usbip, "gadget": Gadgets}


def left_by_gadgets() -> list[str]:
    """Return what gadgets have made in ConfigFS and mounted."""
    mounts = [line.split() for line in Path("/proc/mounts").read_text().splitlines()]
    made = [str(path) for path in (CONFIG_FS / "usb_gadget").iterdir()]
    return made + [where for _, where, kind, *_ in mounts if kind == "functionfs"]


def _options(settings: dict[str, Any]) -> list[str]:
    """Return the options of the program for settings of the virtual board."""
    faults = [
        f"--fault={one['kind']}:{one['exposure']}:{one.get('stream', 'roi')}:"
        f"{one.get('seconds', 0.1)}"
        for one in settings.get("faults", ())
    ]
    width_px, height_px = settings["size_px"]
    return [
        f"--scene={settings['scene']}", "--size", str(width_px), str(height_px),
        f"--frames={settings['frames']}", *faults,
    ]  # fmt: skip
