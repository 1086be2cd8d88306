"""Supervisor's handle of a node process: start it, exchange messages, end it."""

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import psutil

from pipeline.node.wiring import ASIDE
from pipeline.process_tree import Member, descendants, end, lives
from pipeline.protocol.supervision import Assignment, Event, Instruction, Leaving
from pipeline.run.channel import Channel, Exchange
from pipeline.run.descendants import TAG_VARIABLE, end_group, end_tagged, new_tag
from pipeline.run.reaper import Reaper
from pipeline.user_modules import interpreter_options

# otherwise numeric libraries start a thread per core in every process
_THREAD_LIMITS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM",
)  # fmt: skip
PAUSE_S = 0.003  # interval of checks whether a process has ended
KILLED_S = 1.0  # a killed process that takes longer to end hangs in the kernel
MOST_SPARE_LOG = 1 << 20  # bytes of output of processes without an assignment
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Sample:
    """Resource usage of a process at one time."""

    at_s: float
    cpu_s: float
    rss_mb: float
    own_mb: float = 0.0  # private memory: no pools, no libraries
    stopped: bool = False  # stopped by a signal
    pid: int = 0


class NodeProcess:
    """A process and the supervisor's end of its socket; it leads a group, which ends with it."""

    def __init__(
        self, popen: "subprocess.Popen[bytes]", channel: Channel, tag: str,
        reaper: Reaper | None = None,
    ) -> None:  # fmt: skip
        self._popen, self.channel, self.tag, self._reaper = popen, channel, tag, reaper
        self._started: set[Member] = set()  # descendants seen so far
        self._status: int | None = None
        self.reaped = False

    @property
    def pid(self) -> int:
        """The process id."""
        return self._popen.pid

    def ended(self) -> int | None:
        """Return the exit status, negative for a signal; None while it lives. It stays a zombie."""
        if self._status is None:
            try:
                flags = os.WEXITED | os.WNOHANG | os.WNOWAIT
                found = os.waitid(os.P_PID, self._popen.pid, flags)
            except ChildProcessError:  # it was reaped elsewhere
                self._status = self._popen.wait()
                self.reaped = True
            else:
                if found is not None:
                    exited = found.si_code == os.CLD_EXITED
                    self._status = found.si_status if exited else -found.si_status
        return self._status

    def signal(self, number: int) -> None:
        """Send a signal to the process only, if it lives."""
        if self.ended() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._popen.pid, number)

    def look(self) -> None:
        """Record its descendants, which can no longer be found after it dies."""
        if self.ended() is None:
            self._started = set(filter(lives, self._started)) | descendants(self.pid)

    def kill(self) -> None:
        """Kill the process and its descendants."""
        if self.ended() is None:
            self.signal(signal.SIGSTOP)  # a stopped process starts no other
            self.look()
        if not self.reaped:
            end_group(self._popen.pid)
        end(self._started)

    def await_end(self, timeout_s: float) -> bool:
        """Wait for its end while reading its events; return False after the timeout."""
        late_s = time.monotonic() + timeout_s
        while self.ended() is None:
            if time.monotonic() > late_s:
                return False
            self.channel.waiting()
            time.sleep(PAUSE_S)
        return True

    def bury(self, *, outside: bool = True) -> None:
        """Clean up after its end: kill descendants, read its last events, release everything.

        Without `outside`, descendants outside its group are left to the cleanup of the whole run.
        """
        if self.ended() is None or self.channel.fileno() < 0:
            return
        if not self.reaped:
            end_group(self._popen.pid)  # before it is reaped, while its pid is still valid
            self._popen.wait()
            self.reaped = True
            if self._reaper is not None:
                self._reaper.forget(self._popen.pid)
        count = end(self._started)
        if outside:
            count += end_tagged(self.tag)
            count += self._reaper.end() if self._reaper is not None else 0
        if count:
            log.warning("process %d left %d processes behind; killed", self._popen.pid, count)
        self.channel.close()


def spawn(
    run_id: str, folder: Path, modules: Collection[str], *, wanted: bool,
    reaper: Reaper | None = None,
) -> NodeProcess:  # fmt: skip
    """Start a process that imports modules in advance and waits for its first instruction.

    Unless it is `wanted` at once, it imports with low priority. Raises `OSError`.
    """
    words = [run_id, *modules, *(() if wanted else (ASIDE,))]
    tag = new_tag(run_id)
    ours, theirs = socket.socketpair()
    try:
        with theirs, _spare_log(folder).open("ab") as printed:

            def start() -> "subprocess.Popen[bytes]":
                return subprocess.Popen(
                    [sys.executable, *interpreter_options(), "-m", "pipeline.node.process", *words],
                    stdin=theirs.fileno(),
                    stdout=printed,
                    stderr=printed,
                    env={**os.environ, **dict.fromkeys(_THREAD_LIMITS, "1"), TAG_VARIABLE: tag},
                    start_new_session=True,  # so that Ctrl-C reaches only the supervisor
                )

            popen = reaper.start(start) if reaper is not None else start()
    except BaseException:
        ours.close()
        raise
    return NodeProcess(popen, Channel(ours), tag, reaper)


class ProcessHandle:
    """A process with an assignment. It logs to `<folder>/<process>.log`."""

    def __init__(self, process: NodeProcess, job: Assignment, exchange: Exchange) -> None:
        self.name, self._process, self._exchange = job.process, process, exchange
        self.nodes = frozenset(node.name for node in job.nodes)
        self.operators = frozenset(node.operator for node in job.nodes)
        self.ready = self.going = False
        self.left = False  # it has announced its end
        self.killed_s = 0.0  # when; it may take long to end: its memory is freed first
        self.began_s = time.monotonic()
        self.load_s = 0.0  # time it took to open its operators, models included
        self._usage: psutil.Process | None = None
        self._told_left_out = False
        # a killed instance cannot remove them, and Zenoh does not remove those of a closed one
        self._sockets = [Path(job.run_folder) / name for name in job.sockets()]
        exchange.add(process.channel)
        self.tell(job)

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    @property
    def deaf(self) -> bool:
        """Whether it does not read its instructions."""
        return self._process.channel.deaf

    @property
    def gone(self) -> bool:
        """Whether it was cleaned up and all its events were read."""
        return self._process.channel.fileno() < 0 and not self._process.channel.waiting()

    def ended(self) -> int | None:
        """Return the exit status, negative for a signal; None while it lives."""
        return self._process.ended()

    def events(self) -> list[Event]:
        """Return its events since the last call."""
        channel = self._process.channel
        found = channel.events()
        if channel.left_out and not self._told_left_out:
            self._told_left_out = True
            log.warning("%s: sends too many events; the rest is discarded", self.name)
        self.left = self.left or any(isinstance(event, Leaving) for event in found)
        return found

    def tell(self, instruction: Instruction) -> None:
        """Send an instruction, unless the process is deaf."""
        self._process.channel.send(instruction)

    def kill(self, *, with_traceback: bool = False) -> None:
        """Kill it; `with_traceback`: first make it write its stack to the log."""
        if self.ended() is None and with_traceback:
            self._process.signal(signal.SIGUSR1)
            time.sleep(0.05)
        self.killed_s = self.killed_s or time.monotonic()
        self._process.kill()

    def await_end(self, timeout_s: float) -> bool:
        """Wait for its end; return False after the timeout."""
        return self._process.await_end(timeout_s)

    def bury(self, *, outside: bool = True) -> None:
        """Clean up after its end: kill descendants and release everything."""
        if self.ended() is not None:
            self._exchange.remove(self._process.channel)
            self._process.bury(outside=outside)
            for socket_file in self._sockets:
                socket_file.unlink(missing_ok=True)

    def sample(self) -> Sample | None:
        """Return CPU time and memory now; None when it is gone."""
        self._process.look()
        try:
            if self._usage is None:
                self._usage = psutil.Process(self.pid)
            with self._usage.oneshot():
                times = self._usage.cpu_times()
                memory = self._usage.memory_info()
                stopped = self._usage.status() == psutil.STATUS_STOPPED
        except (psutil.Error, OSError):
            return None
        cpu_s, own_mb = times.user + times.system, (memory.rss - memory.shared) / 1e6
        return Sample(time.monotonic(), cpu_s, memory.rss / 1e6, own_mb, stopped, self.pid)


def ending(status: int) -> str:
    """Describe how a process ended.

    >>> ending(-9), ending(1)
    ('signal SIGKILL', 'exit status 1')
    """
    try:
        return f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
    except ValueError:
        return f"signal {-status}"  # a signal without a name


def _spare_log(folder: Path) -> Path:
    """Return the log of processes without an assignment; a long one is truncated."""
    path = folder / "node.stderr.log"
    with contextlib.suppress(OSError):
        if path.stat().st_size > MOST_SPARE_LOG:
            path.unlink()
    return path
