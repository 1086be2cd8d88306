"""MCAP files: channels and messages in, a file that is readable at any moment; and back.

The only importer of `mcap`. Messages are written in chunks, compressed or not. A file whose writer
was killed has no index and may end in the middle of a chunk: the reader returns all whole chunks.
"""

import os
import stat
import struct
import time
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from pipeline.errors import RunError

COMPRESSION = {
    "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE,
}  # fmt: skip
MOST_RECORD_BYTES = 1 << 30
MOST_RECORDS = 1_000_000  # of a chunk
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # of a record: its kind and its length
BROKEN = (
    McapError, ValueError, struct.error, zstandard.ZstdError, EOFError, IndexError, KeyError,
    RuntimeError,  # of lz4
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A channel: its name, and how its messages are encoded."""

    name: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


@dataclass(frozen=True)
class Item:
    """A message of a file."""

    topic: Topic
    log_ns: int  # wall clock, when the recorder received it
    sequence: int
    data: bytes


class Contents(NamedTuple):
    """What a file holds."""

    counts: Counter[tuple[str, str]]  # messages by name of the channel and encoding
    first_ns: int  # wall clock of the first and the last of them
    last_ns: int


class McapWriter:
    """A file in progress; one thread. Raises `OSError` when the disk is full.

    A chunk is written when it has `chunk_bytes`, or when `chunk_s` have passed since the last one:
    what a killed process loses is at most that.
    """

    def __init__(
        self, path: Path, *, chunk_bytes: int, chunk_s: float, compression: str = "zstd"
    ) -> None:
        """Create the file; raises `FileExistsError` rather than overwrite one."""
        self.path, self._chunk_s = path, chunk_s
        self._stream: IO[bytes] = path.open("xb", buffering=0)
        self._counted = _Whole(self._stream)
        self._writer = Writer(
            self._counted,  # type: ignore[arg-type]  # it writes, flushes and tells
            chunk_size=chunk_bytes, compression=COMPRESSION[compression],
        )  # fmt: skip
        self._writer.start(profile="", library="fovea")
        self._channels: dict[str, int] = {}
        self._written_s = time.monotonic()

    @property
    def size_bytes(self) -> int:
        """Return the bytes in the file, without the chunk in progress."""
        return self._counted.size_bytes

    def add(self, item: Item) -> None:
        """Add a message to the chunk in progress."""
        channel = self._channels.get(item.topic.name)
        if channel is None:
            channel = self._register(item.topic)
        self._writer.add_message(
            channel, item.log_ns, item.data, item.log_ns, item.sequence & 0xFFFFFFFF
        )
        self.look()

    def look(self) -> None:
        """Write the chunk in progress if it is old enough."""
        now_s = time.monotonic()
        if now_s - self._written_s >= self._chunk_s:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._written_s = now_s

    def close(self) -> None:
        """Write the last chunk and the index."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._stream.close()

    def _register(self, topic: Topic) -> int:
        schema = self._writer.register_schema(
            topic.schema_name, topic.schema_encoding, topic.schema
        )
        channel = self._writer.register_channel(topic.name, topic.encoding, schema)
        self._channels[topic.name] = channel
        return int(channel)


class _Whole:
    """An unbuffered file whose `write` writes everything, and which knows its size."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self.size_bytes = stream, 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            done = self._stream.write(view)
            self.size_bytes += done
            view = view[done:]
        return len(data)

    def tell(self) -> int:
        return self.size_bytes

    def flush(self) -> None:
        """Nothing is buffered."""


class McapChunks:
    """The whole chunks of a file, in order, up to where it ends or is damaged.

    `broken` says that it is cut or damaged, and after how many chunks; empty: it is neither.
    Schemas and channels are known once the chunk that holds them was read.
    """

    def __init__(self, path: Path) -> None:
        """Raises `RunError` for a file that is no MCAP file."""
        self.path, self.broken = path, ""
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, Topic] = {}
        try:
            first = _begin_of(path, len(MAGIC))
        except (OSError, ValueError) as error:  # a NUL in its name is a ValueError
            why = (isinstance(error, OSError) and error.strerror) or str(error)
            raise RunError(f"{path}: cannot be read: {why}") from error
        if first != MAGIC:
            raise RunError(f"{path}: expected an MCAP file, got something else")

    def scan(self) -> Iterator[tuple[int, list[Item]]]:
        """Yield each chunk's position in the file, and its messages."""
        with self.path.open("rb") as stream:
            records = iter(
                StreamReader(stream, emit_chunks=True, record_size_limit=MOST_RECORD_BYTES).records
            )
            count = 0
            while True:
                place = max(stream.tell(), len(MAGIC))
                try:
                    record = next(records, None)
                    items = self._items(record) if isinstance(record, Chunk) else None
                except (*BROKEN, MemoryError):
                    chunks = f"{count} whole chunk{'s' * (count != 1)}"
                    self.broken = f"{_fault(stream, place)}, after {chunks}"
                    return
                if record is None:
                    return
                if items is not None:
                    yield place, items
                    count += 1

    def at(self, place: int) -> list[Item]:
        """Return the messages of the chunk at a position; raises `RunError`."""
        try:
            with self.path.open("rb") as stream:
                stream.seek(place)
                reader = StreamReader(
                    stream, skip_magic=True, emit_chunks=True, record_size_limit=MOST_RECORD_BYTES
                )
                record = next(iter(reader.records))
                if isinstance(record, Chunk):
                    return self._items(record)
        except (*BROKEN, OSError, MemoryError) as error:
            raise RunError(f"{self.path}: cannot be read at byte {place}: {error}") from error
        raise RunError(f"{self.path}: has changed while it was read")

    def _items(self, chunk: Chunk) -> list[Item]:
        found = []
        for record in breakup_chunk(plain(chunk)):
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                schema = self._schemas[record.schema_id]
                self._topics[record.id] = Topic(
                    name=record.topic, encoding=record.message_encoding, schema_name=schema.name,
                    schema_encoding=schema.encoding, schema=schema.data,
                )  # fmt: skip
            elif isinstance(record, Message):
                topic = self._topics[record.channel_id]
                found.append(Item(topic, record.log_time, record.sequence, record.data))
        return found


def _fault(stream: IO[bytes], place: int) -> str:
    """Return what is wrong with the record at a position: cut by the file's end, or damaged."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(place)
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size or HEAD.unpack(head)[1] > size - place - HEAD.size:
        return "ends early"
    return f"is damaged at byte {place} of {size}, and not read from there on"


def _begin_of(path: Path, size: int) -> bytes:
    """Return the first bytes of a regular file; raises `OSError`.

    It does not wait for the other end of a pipe.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        kind = os.fstat(handle).st_mode
        if not stat.S_ISREG(kind) and not stat.S_ISDIR(kind):
            raise OSError(0, "expected a file, got a device or a pipe")
        return os.read(handle, size)  # of a folder it raises
    finally:
        os.close(handle)


def last(path: Path, topic: str) -> bytes:
    """Return the last message of a channel, found by the index; empty for a file without either."""
    try:
        with path.open("rb") as stream:
            reader = SeekingReader(stream, record_size_limit=MOST_RECORD_BYTES)
            found = next(reader.iter_messages(topics=[topic], reverse=True), None)
    except (*BROKEN, OSError, MemoryError):
        return b""
    return found[2].data if found else b""


def contents(path: Path) -> Contents | None:
    """Return what a file holds by its index; None for a file without one."""
    try:
        with path.open("rb") as stream:
            found = SeekingReader(stream, record_size_limit=MOST_RECORD_BYTES).get_summary()
            if found is None or found.statistics is None:
                return None
            counts = Counter[tuple[str, str]]()
            for number, count in found.statistics.channel_message_counts.items():
                channel = found.channels[number]
                counts[channel.topic, channel.message_encoding] += count
            times_ns = found.statistics.message_start_time, found.statistics.message_end_time
    except (*BROKEN, OSError, MemoryError):
        return None
    return Contents(counts, *times_ns)


def plain(chunk: Chunk) -> Chunk:
    """Return a chunk without compression, checked; raises one of `BROKEN`.

    A few bytes can be made to decompress to many: no more than the chunk says that it has, nor more
    than `MOST_RECORD_BYTES`, are made of them.
    """
    size = chunk.uncompressed_size
    if size > MOST_RECORD_BYTES:
        raise McapError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        data = chunk.data
    if len(data) != size:
        raise McapError(f"a chunk of {size} bytes has another size")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise McapError("a chunk with another checksum")
    place = count = 0
    while place < size:
        place += HEAD.size + HEAD.unpack_from(data, place)[1]
        count += 1
        if count > MOST_RECORDS:
            raise McapError(f"a chunk of more than {MOST_RECORDS} records")
    return replace(chunk, data=data, compression="", uncompressed_crc=0)
