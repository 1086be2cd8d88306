"""Measurement shared by all contestants: writes every byte, reads every byte, five clocks.

A message's first 64 bytes hold its number and the sender's clocks, the rest one value. Per message:
asked (before memory is borrowed), writing, written (= handed over), received (the receiver holds an
array), read. What a transport costs beyond writing and reading is (writing - asked) + (received -
written). Clocks are `time.monotonic_ns`, which is one clock for all processes of a machine.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.whole_file import write_whole

ROOT = Path(__file__).resolve().parents[2]
HEAD_BYTES = 64
WARM_UP = 10  # messages sent first and not counted
BARE_ROUNDS = 20
START_S = 20.0  # for a receiver to get ready
FAREWELL_S = 5.0  # a sender waits that long for a receiver without a report
IDLE_S = 1.0  # after the sender's end: messages that have not arrived by then are lost
COLUMNS = ("number", "asked", "writing", "written", "received", "read")

Bytes = NDArray[np.uint8]  # (nbytes,)


@dataclass(frozen=True, kw_only=True)
class Task:
    """What to send, and the folder through which the two sides report."""

    nbytes: int
    count: int
    rate_hz: float
    folder: Path

    @property
    def total(self) -> int:
        """Messages with the warm-up."""
        return self.count + WARM_UP

    def words(self) -> list[str]:
        """Return the task as options of a command line."""
        return [
            f"--nbytes={self.nbytes}", f"--count={self.count}", f"--rate-hz={self.rate_hz}",
            f"--folder={self.folder}",
        ]  # fmt: skip


def fill(view: Bytes, number: int) -> None:
    """Write every byte."""
    view.fill(value_of(number))


def is_whole(view: Bytes, number: int) -> bool:
    """Read every byte behind the head; return whether each is the one that `fill` wrote."""
    value = value_of(number)
    words = view[HEAD_BYTES : view.size // 8 * 8].view(np.uint64)
    expected = value * 0x0101_0101_0101_0101 * words.size % 2**64
    return int(words.sum(dtype=np.uint64)) == expected and int(view[-1]) == value


def value_of(number: int) -> int:
    """Return a message's byte: successive ones differ, and none is 0 like fresh memory.

    >>> [value_of(n) for n in (0, 1, 250, 251)]
    [1, 2, 251, 1]
    """
    return number % 251 + 1


class Writer:
    """The sending side: keeps the rate, writes, takes the sender's clocks and processor time."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self._bare_ns = bare(lambda view: fill(view, 1), task.nbytes)
        self._start_ns = self._asked_ns = self._cpu_ns = 0
        self._wait_ready()

    def paced(self) -> Iterator[int]:
        """Yield the numbers of messages, each when it is due."""
        for number in range(self.task.total):
            time.sleep(self.due_in_s(number))
            self.begin(number)
            yield number

    def due_in_s(self, number: int) -> float:
        """Return the time until a message is due, zero when it is late."""
        self._start_ns = self._start_ns or time.monotonic_ns()
        due_ns = self._start_ns + int(number / self.task.rate_hz * 1e9)
        return max(0.0, (due_ns - time.monotonic_ns()) / 1e9)

    def begin(self, number: int) -> None:
        """Take the clock, just before memory is borrowed."""
        if number == WARM_UP:
            self._cpu_ns = time.process_time_ns()
        self._asked_ns = time.monotonic_ns()

    def write(self, view: Bytes, number: int) -> None:
        """Write the whole message into (nbytes,) memory; call it just before handing over."""
        writing_ns = time.monotonic_ns()
        fill(view, number)
        head = view[:HEAD_BYTES].view(np.int64)
        head[:3] = number, self._asked_ns, writing_ns
        head[3] = time.monotonic_ns()

    def save(self) -> None:
        """Write the sender's report; call it after the last message was sent."""
        cpu_ns = time.process_time_ns() - self._cpu_ns
        report = {"sender_cpu_ns": cpu_ns, "bare_write_ns": self._bare_ns}
        _put(self.task.folder / "sender.json", report)

    def wait_read(self) -> None:
        """Wait for the receiver's report: some transports release their memory when they end."""
        deadline = time.monotonic() + FAREWELL_S
        while not (self.task.folder / "receiver.json").exists() and time.monotonic() < deadline:
            time.sleep(0.01)

    def _wait_ready(self) -> None:
        deadline = time.monotonic() + START_S
        while not (self.task.folder / "ready").exists():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{self.task.folder}: no receiver within {START_S:.0f} s")
            time.sleep(0.01)


class Meter:
    """The receiving side: takes the clocks, reads, records. Call `ready` when subscribed."""

    def __init__(self, task: Task) -> None:
        self.task = task
        probe = np.ones(task.nbytes, np.uint8)
        self._bare_ns = bare(lambda view: is_whole(view, 0), task.nbytes, probe)
        self._rows = np.zeros((task.total, len(COLUMNS)), np.int64)
        self._seen, self._torn, self._last = 0, 0, -1
        self._cpu_ns = self._cpu_end_ns = 0
        self._idle_since_s = time.monotonic()

    def ready(self) -> None:
        """Report ready, so that the sender begins."""
        (self.task.folder / "ready").touch()
        self._idle_since_s = time.monotonic()

    def take(self, view: Bytes) -> None:
        """Read one message. The view is not kept."""
        received_ns = time.monotonic_ns()
        number, *sent = view[:HEAD_BYTES].view(np.int64)[:4].tolist()
        whole = is_whole(view, number)
        read_ns = time.monotonic_ns()
        self._torn += not whole
        self._last = number
        if number >= WARM_UP:
            self._cpu_ns = self._cpu_ns or time.process_time_ns()
            self._cpu_end_ns = time.process_time_ns()
            self._rows[self._seen] = (number, *sent, received_ns, read_ns)
            self._seen += 1
        self._idle_since_s = time.monotonic()

    @property
    def finished(self) -> bool:
        """Whether the last message was read, or the sender has ended and nothing more arrives."""
        if self._last == self.task.total - 1:
            return True
        idle_s = time.monotonic() - self._idle_since_s
        return idle_s > IDLE_S and (self.task.folder / "sender.json").exists()

    def save(self) -> None:
        """Write the receiver's report."""
        report = {
            "receiver_cpu_ns": self._cpu_end_ns - self._cpu_ns,
            "bare_read_ns": self._bare_ns,
            "torn": self._torn,
            "samples": self._rows[: self._seen].tolist(),
        }
        _put(self.task.folder / "receiver.json", report)


def bare(act: Callable[[Bytes], object], nbytes: int, view: Bytes | None = None) -> list[int]:
    """Return the durations of a few calls on plain memory of this process, in nanoseconds."""
    memory = np.zeros(nbytes, np.uint8) if view is None else view
    times = []
    for _ in range(BARE_ROUNDS + 1):
        begun = time.monotonic_ns()
        act(memory)
        times.append(time.monotonic_ns() - begun)
    return times[1:]  # the first one touches fresh pages


def collect(task: Task, contestant: str, library: str) -> dict[str, Any]:
    """Return both sides' reports as one, JSON-ready; `samples`: rows of COLUMNS, in nanoseconds."""
    sides = [json.loads((task.folder / f"{s}.json").read_text()) for s in ("sender", "receiver")]
    return {
        "contestant": contestant, "version": version(library), "nbytes": task.nbytes,
        "rate_hz": task.rate_hz, "sent": task.count, **sides[0], **sides[1],
    }  # fmt: skip


def contestant(
    module: str, library: str, launch: Callable[[Task], None],
    roles: dict[str, Callable[[Task], None]] | None = None,
) -> None:  # fmt: skip
    """Run a contestant's command line: `launch` runs both sides, a role only one of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--nbytes", type=int, required=True)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--rate-hz", type=float, default=30.0)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--role", choices=sorted(roles or {}))
    given = parser.parse_args()

    def task(folder: Path) -> Task:
        return Task(nbytes=given.nbytes, count=given.count, rate_hz=given.rate_hz, folder=folder)

    if roles and given.role:
        roles[given.role](task(given.folder))
        return
    with tempfile.TemporaryDirectory(prefix="fovea-ruler-") as folder:
        launch(task(Path(folder)))
        print(json.dumps(collect(task(Path(folder)), module, library)))


def two_processes(module: str) -> Callable[[Task], None]:
    """Return what launches a contestant's roles, `receive` and `send`, as two processes."""

    def launch(task: Task) -> None:
        words = [sys.executable, "-m", f"bench.peers.{module}", *task.words()]
        children = [
            subprocess.Popen([*words, f"--role={role}"], cwd=ROOT, stdout=sys.stderr)
            for role in ("receive", "send")
        ]
        limit_s = START_S + 5 * task.total / task.rate_hz
        try:
            for child in reversed(children):
                if child.wait(limit_s):
                    raise SystemExit(f"{module}: a side ended with {child.returncode}")
        finally:
            for child in children:
                child.kill()
                child.wait()

    return launch


def _put(path: Path, report: dict[str, Any]) -> None:
    write_whole(path, json.dumps(report))  # in one step, because the other side polls for it
