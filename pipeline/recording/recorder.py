"""Record messages in a thread of its own: messages in, one or several MCAP files out.

The caller only queues. The queue is limited in bytes: a message that may not be lost waits for
room, any other is dropped and counted. Files are begun anew by size and time, never overwritten.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.errors import MessageError, RunError
from pipeline.messages import Frame, Message
from pipeline.recording import foxglove
from pipeline.recording.annotations import annotations
from pipeline.recording.mcap_file import Item, McapWriter
from pipeline.recording.records import IMAGE, fact, items_of, topic_of
from pipeline.text import said_by

MOST_PARTS = 100_000
LOOK_S = 0.1
CLOSE_S = 30.0
NS = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a recording; 0: none."""

    chunk_bytes: int = 4 << 20
    chunk_s: float = 0.5
    file_bytes: int = 0
    file_s: float = 0.0
    ring_s: float = 0.0  # keep the last seconds in memory, and write them on request only
    ring_bytes: int = 256 << 20
    queue_bytes: int = 256 << 20
    compression: str = "zstd"  # zstd | lz4 | none


@dataclass
class Account:
    """The messages of one output."""

    recorded: int = 0
    dropped: int = 0  # the queue was full, or the disk
    passed: int = 0  # left the ring, or were in it at the end: nobody asked for them
    gaps: int = 0  # frames between two recorded ones of a stream
    refused: int = 0  # could not be encoded
    last: tuple[str, int] = field(default=("", -1))

    def count(self, stream: str, seq: int) -> None:
        """Count a recorded message and the gap before it."""
        if self.last[0] == stream:
            self.gaps += max(0, seq - self.last[1] - 1)
        self.last, self.recorded = (stream, seq), self.recorded + 1

    def figures(self) -> dict[str, int]:
        """Return the counts by name."""
        names = ("recorded", "dropped", "passed", "gaps", "refused")
        return {name: getattr(self, name) for name in names}


class _Queued(NamedTuple):
    """A message that waits to be written."""

    output: str
    message: Message
    at_ns: int
    nbytes: int


class _Encoded(NamedTuple):
    """What is to be written together: facts, and at most one message with what belongs to it."""

    items: list[Item]
    output: str = ""  # of the message; empty: there is none
    stream: str = ""
    seq: int = -1

    @property
    def nbytes(self) -> int:
        return sum(len(item.data) for item in self.items)


class Recorder:
    """Writes recordings. `failure` says why no more can be written; empty while it can."""

    def __init__(self, path: Path, limits: Limits | None = None) -> None:
        """Begin the first file; raises `RunError` when it cannot be made."""
        self._path, self._limits = path, limits or Limits()
        self._waiting: deque[_Queued | str] = deque()  # a text: why the ring is to be written
        self._facts: deque[Item] = deque(maxlen=10_000)
        self._kept: dict[str, Item] = {}  # the newest of each fact, for the next file
        self._picture = ("", (0, 0))  # the output that boxes are drawn on, and its size
        self._ring: deque[_Encoded] = deque()
        self._ring_bytes = self._bytes = self._seen_bytes = 0
        self._room, self._ended = threading.Condition(), False
        self.accounts: dict[str, Account] = {}
        self.files: list[Path] = []
        self.failure = ""
        self._unwritten: Counter[str] = Counter()  # by output: messages of the chunk in progress
        self._in_hand = ""  # the output of the message that is being written
        self._writer: McapWriter | None = None if self._limits.ring_s else self._begin()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def add(self, output: str, message: Message, *, wait: bool = False) -> None:
        """Queue a message; `wait`: for room rather than drop it."""
        nbytes = sum(v.nbytes for v in vars(message).values() if isinstance(v, np.ndarray)) + 1024
        with self._room:
            account = self.accounts.setdefault(output, Account())
            while wait and not (self._fits(nbytes) or self.failure):
                self._room.wait(LOOK_S)
            if self.failure or not self._fits(nbytes):
                account.dropped += 1
                return
            self._bytes += nbytes
            self._waiting.append(_Queued(output, message, time.time_ns(), nbytes))
            self._room.notify_all()

    def note(self, name: str, value: Any, at_ns: int = 0) -> None:
        """Record a fact about the graph, of now or `at_ns` (wall clock).

        The newest of each name begins every file.
        """
        with self._room:
            self._facts.append(fact(name, value, at_ns or time.time_ns()))
            self._room.notify_all()

    def dump(self, why: str) -> None:
        """Write what the ring holds to the next file, once it holds everything queued so far."""
        with self._room:
            if not self._ended and why not in self._waiting:
                self._waiting.append(why)
                self._room.notify_all()

    def figures(self) -> dict[str, dict[str, int]]:
        """Return the counts of every output."""
        with self._room:
            return {output: account.figures() for output, account in self.accounts.items()}

    def close(self) -> str:
        """Write everything that waits, end the file and return the failure, or an empty string."""
        with self._room:
            self._ended = True
            self._room.notify_all()
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            return f"{self._path}: not written within {CLOSE_S:.0f} s; its whole chunks are"
        return self.failure

    def _fits(self, nbytes: int) -> bool:
        return not self._bytes or self._bytes + nbytes <= self._limits.queue_bytes

    def _run(self) -> None:
        try:
            for encoded, why in self._taken():
                if self._limits.ring_s:
                    self._keep(encoded, why)
                elif encoded.items:
                    self._write(encoded)
                if self._writer is not None:
                    self._writer.look()
                    self._note_chunk(self._writer)
            while self._ring:
                self._pass()
            if self._writer is not None:
                self._end(self._writer)
        except Exception as error:  # whatever ends this thread, writers must not wait for it
            why = (isinstance(error, OSError) and error.strerror) or said_by(error)
            with self._room:
                self.failure = f"{self._path}: {why}; what was written before can be read"
                for lost in (*self._waiting, *self._ring):
                    if not isinstance(lost, str) and lost.output:
                        self.accounts[lost.output].dropped += 1
                for output in (*self._unwritten.elements(), *filter(None, [self._in_hand])):
                    self.accounts[output].recorded -= 1
                    self.accounts[output].dropped += 1
                self._waiting.clear()
                self._ring.clear()
                self._room.notify_all()
            if self._writer is not None:
                self._writer.abandon()

    def _taken(self) -> Iterator[tuple[_Encoded, str]]:
        """Yield what to write next, or why to write the ring, and nothing at intervals."""
        while True:
            with self._room:
                if not (self._waiting or self._facts or self._ended):
                    self._room.wait(LOOK_S)
                facts = list(self._facts)
                self._facts.clear()
                taken = self._waiting.popleft() if self._waiting else ""
                over = self._ended and not taken and not facts
            if over:
                return
            self._kept.update({item.topic.name: item for item in facts})
            if isinstance(taken, str):
                yield _Encoded(facts), taken
                continue
            yield self._encoded(taken, facts), ""
            with self._room:
                self._bytes -= taken.nbytes
                self._room.notify_all()

    def _encoded(self, queued: _Queued, facts: list[Item]) -> _Encoded:
        account, header = self.accounts[queued.output], queued.message.header
        try:
            items = items_of(queued.output, queued.message, queued.at_ns)
        except MessageError:
            account.refused += 1
            return _Encoded(facts)
        self._find_picture(queued)
        on_it = annotations(queued.message, self._picture[1])
        if on_it is not None:
            topic = foxglove.topic(f"{topic_of(queued.output)}/boxes", foxglove.ANNOTATIONS)
            items.append(Item(topic, queued.at_ns, header.seq, on_it))
        return _Encoded([*facts, *items], queued.output, header.stream, header.seq)

    def _find_picture(self, queued: "_Queued") -> None:
        """Take the first output that shows the whole field as the one that boxes are drawn on."""
        message, (output, _) = queued.message, self._picture
        if isinstance(message, Frame) and output in ("", queued.output):
            geometry = message.header.geometry
            whole = (0, 0, geometry.width_px, geometry.height_px)
            if any(whole) and message.window == whole:
                self._picture = queued.output, message.size_px
                if not output:
                    shown = {"picture": f"{topic_of(queued.output)}{IMAGE}"}
                    self._facts.append(fact("boxes", shown, queued.at_ns))

    def _write(self, encoded: _Encoded) -> None:
        assert self._writer is not None
        limits, age_s = self._limits, time.monotonic() - self._began_s
        large = limits.file_bytes and self._writer.size_bytes >= limits.file_bytes
        if large or (limits.file_s and age_s >= limits.file_s):
            try:
                self._end(self._writer)  # before this message is counted, which it does not hold
                self._unwritten.clear()
                self._writer = None
                self._writer = self._begin()
            except BaseException:
                if encoded.output:
                    self.accounts[encoded.output].dropped += 1
                raise
        self._count(encoded)
        self._add(self._writer, encoded.items)

    def _count(self, encoded: _Encoded) -> None:
        """Count a message as recorded that is now written."""
        if encoded.output:
            self.accounts[encoded.output].count(encoded.stream, encoded.seq)
            self._in_hand = encoded.output

    def _add(self, writer: McapWriter, items: list[Item]) -> None:
        for item in items:
            writer.add(item)
            if self._in_hand and item.topic.name == topic_of(self._in_hand):
                self._unwritten[self._in_hand] += 1
                self._in_hand = ""
            self._note_chunk(writer)

    def _note_chunk(self, writer: McapWriter) -> None:
        """Note when a chunk has been written: what was in it is recorded."""
        if writer.size_bytes != self._seen_bytes:
            self._seen_bytes = writer.size_bytes
            self._unwritten.clear()

    def _keep(self, encoded: _Encoded, why: str) -> None:
        """Keep the newest in memory; write them for an event."""
        limits = self._limits
        if encoded.items:
            self._ring.append(encoded)
            self._ring_bytes += encoded.nbytes
        newest_ns = self._ring[-1].items[-1].log_ns if self._ring else 0
        while self._ring and (
            self._ring_bytes > limits.ring_bytes
            or self._ring[0].items[-1].log_ns < newest_ns - limits.ring_s * NS
        ):
            self._pass()
        if why:
            held = {id(item) for kept in self._ring for item in kept.items}
            self._writer = writer = self._begin(held)
            writer.add(fact("events", {"event": why}, time.time_ns()))
            while self._ring:
                kept = self._ring.popleft()
                self._ring_bytes -= kept.nbytes
                self._count(kept)
                self._add(writer, kept.items)
            self._end(writer)
            self._writer = None
            self._unwritten.clear()

    def _pass(self) -> None:
        """Let go of the oldest that the ring holds."""
        oldest = self._ring.popleft()
        self._ring_bytes -= oldest.nbytes
        if oldest.output:
            self.accounts[oldest.output].passed += 1

    def _begin(self, later: Collection[int] = ()) -> McapWriter:
        """Begin a file with the newest facts but those that are written `later`, by identity."""
        path = self._path
        for part in range(2, MOST_PARTS):
            try:
                writer = McapWriter(
                    path,
                    chunk_bytes=self._limits.chunk_bytes,
                    chunk_s=self._limits.chunk_s,
                    compression=self._limits.compression,
                )
            except FileExistsError:
                path = self._path.with_stem(f"{self._path.stem}-{part}")
                continue
            except OSError as error:
                raise RunError(f"{path}: cannot be written: {error.strerror}") from error
            self._began_s = time.monotonic()
            self.files.append(path)
            try:
                for item in self._kept.values():
                    if id(item) not in later:
                        writer.add(item)
            except BaseException:
                writer.abandon()
                raise
            self._seen_bytes = writer.size_bytes
            return writer
        raise RunError(f"{self._path}: expected fewer than {MOST_PARTS} files beside it")

    def _end(self, writer: McapWriter) -> None:
        end = {"accounts": self.figures(), "file": len(self.files)}
        writer.add(fact("end", end, time.time_ns()))
        writer.close()


def total(figures: dict[str, dict[str, int]]) -> dict[str, int]:
    """Return the counts of all outputs together.

    >>> total({"a": {"recorded": 2, "gaps": 1}, "b": {"recorded": 3, "gaps": 0}})
    {'recorded': 5, 'gaps': 1}
    """
    found: Counter[str] = Counter()
    for one in figures.values():
        found.update(one)
    return dict(found)
