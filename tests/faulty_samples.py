"""Operators with one fault each, to test how a supervisor handles them."""

import ctypes
import math
import multiprocessing
import os
import shlex
import signal
import subprocess
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline import Frame, Input, Message, Operator, Source
from tests.samples import Pair, Ticker


@dataclass(frozen=True, kw_only=True)
class SickSettings:
    """The fault, and the frame at which it begins."""

    ill_from: int = 10
    kind: str = ""  # leak, deadlock, seize
    open_s: float = 0.0
    again: str = ""  # a file that counts openings: with one, only the second takes open_s


class Sick(Operator[SickSettings, Frame]):
    """Passes frames on until its fault begins."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        self.kept: list[bytearray] = []
        self.lock = threading.Lock()
        seen = Path(self.settings.again) if self.settings.again else None
        if seen is None or (seen.exists() and seen.read_text() == "once"):
            time.sleep(self.settings.open_s)
        if seen is not None:
            seen.write_text("twice" if seen.exists() else "once")

    def on_frame(self, frame: Frame) -> Frame:
        if frame.header.seq == self.settings.ill_from and self.settings.kind == "deadlock":
            self.lock.acquire()
            self.lock.acquire()
        if frame.header.seq == self.settings.ill_from and self.settings.kind == "seize":
            ctypes.PyDLL(None).sleep(1000)  # while it holds the interpreter lock
        if frame.header.seq > self.settings.ill_from and self.settings.kind == "leak":
            self.kept.append(bytearray(b"x") * 4_000_000)
        return replace(frame, pixels=frame.pixels)


@dataclass(frozen=True, kw_only=True)
class UnrulySettings:
    """The fault and its frame; with `once`, a file, it occurs only while the file is missing."""

    kind: str = ""
    at: int = 10
    size: int = 0
    note: str = ""  # a file for the process ids of what it starts
    once: str = ""


class Mute(Exception):
    """An error whose text raises another error."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


class Unruly(Operator[UnrulySettings, Frame]):
    """Passes frames on until the fault in its settings."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        if self.settings.kind == "exit_in_open" and self.first():
            raise SystemExit(0)
        if self.settings.kind == "raise_in_open":
            raise ValueError("cannot open")
        if self.settings.kind == "die_in_open":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.settings.kind == "slow_open":
            time.sleep(1000)

    def first(self) -> bool:
        """Return whether the fault has not occurred before, and record that it has."""
        once = Path(self.settings.once) if self.settings.once else None
        if once is not None and once.exists():
            return False
        if once is not None:
            once.touch()
        return True

    def on_frame(self, frame: Frame) -> Frame:
        act = getattr(self, f"do_{self.settings.kind}", None)
        if act is not None and frame.header.seq >= self.settings.at and self.first():
            act()
        return replace(frame, pixels=frame.pixels)

    def close(self) -> None:
        if self.settings.kind == "exit_in_close":
            os._exit(0)
        if self.settings.kind == "hang_in_close":
            time.sleep(1000)

    def summary(self) -> Mapping[str, Any]:
        if self.settings.kind == "huge_summary":
            return {"huge": [0.5] * self.settings.size}
        if self.settings.kind == "long_summary":
            return {"long": "x" * self.settings.size}
        if self.settings.kind == "wrong_summary":
            return {"kept": 3, "wrong": {"deep": object()}, "round": math.pi}
        if self.settings.kind == "no_summary":
            return None  # type: ignore[return-value]
        if self.settings.kind == "odd_summary":
            return {"frames": 3, "iou": {"mean": None}, "failure": "no", "\ud800": "\x1b[2J\ud800"}
        if self.settings.kind == "exit_in_summary":
            raise SystemExit(0)
        return {}

    def headline(self) -> str:
        if self.settings.kind == "huge_headline":
            return f"{time.monotonic()} \x1b[2J\ud800" + "x" * self.settings.size
        if self.settings.kind == "exit_in_headline" and self.first():
            raise SystemExit(0)
        return ""

    def state(self) -> object | None:
        if self.settings.kind == "broken_state":
            raise ValueError("no state" + "x" * self.settings.size)
        return None

    def _note(self, pid: int) -> None:
        with Path(self.settings.note).open("a") as file:
            file.write(f"{pid}\n")

    def do_fork_and_die(self) -> None:
        """Leave a child that inherits all open files, and die."""
        pid = os.fork()
        if not pid:
            while True:
                time.sleep(1000)
        self._note(pid)
        os.kill(os.getpid(), signal.SIGKILL)

    def do_fork_many(self) -> None:
        """Start workers with `multiprocessing`, and continue."""
        for _ in range(2):
            worker = multiprocessing.get_context("fork").Process(target=time.sleep, args=(1000,))
            worker.start()
            self._note(worker.pid or 0)

    def do_leave_session(self) -> None:
        """Start a program in a session of its own, and die."""
        self.do_start_session()
        os.kill(os.getpid(), signal.SIGKILL)

    def do_start_session(self) -> None:
        """Start a program in a session of its own."""
        self._note(subprocess.Popen(["sleep", "1000"], start_new_session=True).pid)

    def do_escape(self) -> None:
        """Start a program in a session of its own, without the environment of this process."""
        self._note(subprocess.Popen(["sleep", "1000"], start_new_session=True, env={}).pid)

    def do_escape_and_die(self) -> None:
        """Start such a program, and die at once."""
        self.do_escape()
        os.kill(os.getpid(), signal.SIGKILL)

    def do_escape_twice(self) -> None:
        """Start such a program by one that ends at once, so that its parent is gone."""
        script = f"setsid env -i sleep 1000 & echo $! >> {shlex.quote(self.settings.note)}"
        subprocess.run(["sh", "-c", script], check=True)

    def do_tell(self) -> None:
        """Record that the operator works."""
        self._note(os.getpid())

    def do_hang(self) -> None:
        """Record the process id, and hang."""
        self._note(os.getpid())
        time.sleep(1000)

    def do_exit_0(self) -> None:
        """Exit without a message."""
        os._exit(0)

    def do_segfault(self) -> None:
        """Crash as an extension module does."""
        ctypes.string_at(0)

    def do_system_exit(self) -> None:
        """Raise `SystemExit`, as a script does."""
        raise SystemExit(0)

    def do_keyboard_interrupt(self) -> None:
        """Raise `KeyboardInterrupt`, as Ctrl-C does."""
        raise KeyboardInterrupt

    def do_group(self) -> None:
        """Raise a group of two exceptions."""
        raise BaseExceptionGroup("both", [SystemExit(0), ValueError("one\x1b[2J of two")])

    def do_long_text(self) -> None:
        """Raise an error with a long text."""
        raise ValueError("x" * self.settings.size)

    def do_odd_text(self) -> None:
        """Raise an error whose text has control characters and surrogates."""
        raise ValueError("odd \ud800\x1b[2J\x00\u202e text\nand more")

    def do_mute(self) -> None:
        """Raise an error whose text raises another error."""
        raise Mute

    def do_thread(self) -> None:
        """Raise an error in a thread."""

        def fail() -> None:
            raise ValueError("in a thread")

        threading.Thread(target=fail).start()

    def do_close_streams(self) -> None:
        """Close the standard streams, print, and raise an error."""
        os.closerange(0, 3)
        print("into nothing")
        raise ValueError("after it closed everything")

    def do_print(self) -> None:
        """Print many bytes that are no text, and raise an error."""
        for _ in range(self.settings.size // 65536):
            os.write(1, b"\xff\x00\x1b" * 21845)
        raise ValueError("after it printed")


class Deserter(Ticker):
    """A source that exits at its tenth picture, without a message."""

    def produce(self) -> Mapping[str, Message] | None:
        if self.seq == 10:
            os._exit(0)
        return super().produce()


@dataclass(frozen=True, kw_only=True)
class SlowStartSettings:
    """How long it opens, and the stem of the files that tell what it did."""

    open_s: float = 0.5
    notes: str = ""


class SlowStart(Source[SlowStartSettings, Frame]):
    """A source that takes its time to open, and ends at its first exposure."""

    def open(self) -> None:
        self._note("opens")
        time.sleep(self.settings.open_s)
        self._note("opened")

    def produce(self) -> Frame | None:
        self._note("exposes")
        return None

    def close(self) -> None:
        self._note("closes")

    def _note(self, word: str) -> None:
        Path(f"{self.settings.notes}-{word}").touch()


class Clinging(Pair):
    """Takes ten minutes to close."""

    def close(self) -> None:
        time.sleep(600)
