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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from pydantic import TypeAdapter

from pipeline.node import Assignment

Events = queue.SimpleQueue[tuple[str, int, dict[str, Any]]]  # process, pid, event


@dataclass(frozen=True)
class Sample:
    """What the process used at one moment."""

    at_s: float
    cpu_s: float
    rss_mb: float


class Child:
    """A started process. Its standard error goes to `<folder>/<process>.log`."""

    def __init__(self, job: Assignment, events: Events, *, threads: int) -> None:
        self.name = job.process
        self.ready = self.going = False
        mode = "wb" if max(job.epochs.values()) == 1 else "ab"
        self._log = (Path(job.run_folder) / f"{job.process}.log").open(mode)
        self._popen = subprocess.Popen(
            [sys.executable, "-m", "pipeline.node", job.prefix],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**os.environ, **_thread_limits(threads)},
            start_new_session=True,  # Ctrl-C is the supervisor's affair
        )
        self.started_s = time.monotonic()
        self._process = psutil.Process(self._popen.pid)
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
        for pipe in (self._popen.stdin, self._popen.stdout, self._log):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()

    def sample(self) -> Sample | None:
        """Processor time and memory now; None when it is gone."""
        try:
            with self._process.oneshot():
                times = self._process.cpu_times()
                rss = self._process.memory_info().rss
        except psutil.Error:
            return None
        return Sample(time.monotonic(), times.user + times.system, rss / 1e6)

    def _write(self, line: str) -> None:
        assert self._popen.stdin is not None
        with contextlib.suppress(OSError):  # it died: the next look will notice
            self._popen.stdin.write(line.encode() + b"\n")
            self._popen.stdin.flush()

    def _listen(self, events: Events) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            with contextlib.suppress(ValueError):
                event = json.loads(line)
                if isinstance(event, dict):
                    events.put((self.name, self.pid, event))


def _thread_limits(threads: int) -> dict[str, str]:
    """Keep numeric libraries from starting a thread per core in every process."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
             "OPENCV_FOR_THREADS_NUM")  # fmt: skip
    return dict.fromkeys(names, str(threads))
