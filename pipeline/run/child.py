"""One node process as its supervisor holds it: started, spoken to, listened to, ended."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from pydantic import TypeAdapter

from pipeline.node.wiring import ASIDE, Assignment

# numeric libraries would start a thread per core in every process
_THREAD_LIMITS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM",
)  # fmt: skip
Events = queue.SimpleQueue[tuple[str, int, dict[str, Any]]]  # process, pid, event


@dataclass(frozen=True)
class Sample:
    """What the process used at one moment."""

    at_s: float
    cpu_s: float
    rss_mb: float
    own_mb: float = 0.0  # what it shares with nobody: no pools, no libraries
    stopped: bool = False  # by a signal; it does nothing at all


def spawn(
    prefix: str, folder: Path, modules: Collection[str], *, wanted: bool
) -> "subprocess.Popen[bytes]":
    """A process that imports what it may need and waits for its assignment.

    Unless it is `wanted` at once, its imports leave the cores to others.
    """
    words = [prefix, *modules, *(() if wanted else (ASIDE,))]
    with (folder / "node.stderr.log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "pipeline.node.process", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            env={**os.environ, **dict.fromkeys(_THREAD_LIMITS, "1")},
            start_new_session=True,  # Ctrl-C is the supervisor's affair
        )


class Child:
    """A process with an assignment. It logs to `<folder>/<process>.log`."""

    def __init__(self, popen: "subprocess.Popen[bytes]", job: Assignment, events: Events) -> None:
        self.name, self._popen = job.process, popen
        self.ready = self.going = False
        self.began_s = time.monotonic()
        self.load_s = 0.0  # time it took to open its operators, models included
        self._process = psutil.Process(popen.pid)
        self._reader = threading.Thread(target=self._listen, args=(events,), daemon=True)
        self._reader.start()
        self._write(TypeAdapter(Assignment).dump_json(job).decode())

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._popen.pid

    def ended(self) -> int | None:
        """The exit status, negative for a signal; None while it lives."""
        return self._popen.poll()

    def tell(self, word: str) -> None:
        """Say `go`, `finish` or `stop`."""
        self._write(word)

    def order(self, do: str, **more: Any) -> None:
        """Have something done to one node (`pipeline.node.process.Process.do`)."""
        self._write(json.dumps({"do": do, **more}))

    def kill(self, *, with_traceback: bool = False) -> None:
        """End it at once; first have it write where it stands, when asked."""
        if self.ended() is None and with_traceback:
            self._popen.send_signal(signal.SIGUSR1)
            time.sleep(0.05)
        if self.ended() is None:
            self._popen.kill()

    def reap(self, timeout_s: float) -> None:
        """Wait for the end, helping when it takes too long."""
        try:
            self._popen.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.wait()
        self._reader.join(1.0)
        close_pipes(self._popen)

    def sample(self) -> Sample | None:
        """Processor time and memory now; None when it is gone."""
        try:
            with self._process.oneshot():
                times = self._process.cpu_times()
                memory = self._process.memory_info()
                stopped = self._process.status() == psutil.STATUS_STOPPED
        except psutil.Error:
            return None
        cpu_s, own_mb = times.user + times.system, (memory.rss - memory.shared) / 1e6
        return Sample(time.monotonic(), cpu_s, memory.rss / 1e6, own_mb, stopped)

    def _write(self, line: str) -> None:
        assert self._popen.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # it died: the next look will notice
            self._popen.stdin.write(line.encode() + b"\n")
            self._popen.stdin.flush()

    def _listen(self, events: Events) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            with contextlib.suppress(ValueError):
                event = json.loads(line)
                if isinstance(event, dict):
                    events.put((self.name, self.pid, event))


def ending(status: int) -> str:
    """How a process ended, in words.

    >>> ending(-9), ending(1)
    ('signal SIGKILL', 'exit status 1')
    """
    return f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


def close_pipes(popen: "subprocess.Popen[bytes]") -> None:
    """Give back the supervisor's ends."""
    for pipe in (popen.stdin, popen.stdout):
        with contextlib.suppress(OSError):
            if pipe is not None:
                pipe.close()
