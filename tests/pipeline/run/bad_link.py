"""A link between two hosts over a unix socket, with delay, loss, stalls and cuts."""

import random
import socket
import threading
import time
from collections import deque
from pathlib import Path

PIECE_BYTES = 65536
AGAIN_S = 0.2  # a stream that loses a piece waits for it to be sent again
HELD = 256  # pieces under way in one direction; more have to wait, as in a network's queues


class BadLink:
    """Listens at `near` and forwards everything to `far`; use as a context.

    `delay_s` holds for pieces that come from now on, `loss` is the share of pieces that come
    `AGAIN_S` later, with everything behind them. While `stalled` is set nothing passes, but the
    link stands; `cut` ends it, and no new one forms until `mend`.
    """

    def __init__(self, near: Path, far: Path, *, seed: int = 1) -> None:
        self._near, self._far = near, far
        self.delay_s = 0.0
        self.loss = 0.0
        self.stalled = threading.Event()
        self.passed_bytes = 0
        self.links = 0
        self._chance = random.Random(seed)
        self._severed = threading.Event()
        self._ended = threading.Event()
        self._ends: list[socket.socket] = []
        self._door = socket.socket(socket.AF_UNIX)
        self._door.bind(str(near))
        self._door.listen()
        threading.Thread(target=self._admit, daemon=True).start()

    def __enter__(self) -> "BadLink":
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self.cut()
        self._door.shutdown(socket.SHUT_RDWR)
        self._door.close()

    def cut(self) -> None:
        """Take the link down: both sides see it end, new ones end at once."""
        self._severed.set()
        ends, self._ends = self._ends, []
        for end in ends:
            _shut(end)

    def mend(self) -> None:
        """Let new links form again."""
        self._severed.clear()

    def _admit(self) -> None:
        while not self._ended.is_set():
            try:
                near, _ = self._door.accept()
            except OSError:
                return
            far = socket.socket(socket.AF_UNIX)
            try:
                if self._severed.is_set():
                    raise OSError("cut")
                far.connect(str(self._far))
            except OSError:
                near.close()
                far.close()
                continue
            self.links += 1
            self._ends += [near, far]
            for source, sink in ((near, far), (far, near)):
                _Way(self, source, sink)

    def due_s(self) -> float:
        """Return when a piece that arrives now is to leave."""
        lost = self._chance.random() < self.loss
        return time.monotonic() + self.delay_s + (AGAIN_S if lost else 0.0)


class _Way:
    """One direction of one link: a thread that takes pieces, one that hands them on in time."""

    def __init__(self, link: BadLink, source: socket.socket, sink: socket.socket) -> None:
        self._link, self._source, self._sink = link, source, sink
        self._pieces: deque[tuple[float, bytes]] = deque()
        self._changed = threading.Condition()
        for work in (self._take, self._give):
            threading.Thread(target=work, daemon=True).start()

    def _take(self) -> None:
        piece = b"-"
        while piece:
            try:
                piece = self._source.recv(PIECE_BYTES)
            except OSError:
                piece = b""
            with self._changed:
                while len(self._pieces) >= HELD:
                    self._changed.wait()
                self._pieces.append((self._link.due_s(), piece))
                self._changed.notify_all()

    def _give(self) -> None:
        while True:
            with self._changed:
                while not self._pieces:
                    self._changed.wait()
                due_s, piece = self._pieces[0]
            time.sleep(max(0.0, due_s - time.monotonic()))
            while self._link.stalled.is_set() and piece:
                time.sleep(0.01)
            try:
                if not piece:
                    raise OSError("it ended")
                self._sink.sendall(piece)
                self._link.passed_bytes += len(piece)
            except OSError:
                piece = b""
            with self._changed:
                self._pieces.popleft()
                if not piece:
                    self._pieces.clear()
                self._changed.notify_all()
            if not piece:
                _shut(self._source)
                _shut(self._sink)
                return


def _shut(end: socket.socket) -> None:
    try:
        end.shutdown(socket.SHUT_RDWR)
    except OSError:
        pass
    finally:
        end.close()
