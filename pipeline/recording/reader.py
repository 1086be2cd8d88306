"""Read a recording: its file -> messages of an output by frame, and facts about the graph.

The file is scanned once; pictures stay in it, and the chunks read last are kept in memory.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec

from pipeline.errors import MessageError, RunError
from pipeline.messages import Message, altered
from pipeline.recording.mcap_file import Item, McapChunks, last
from pipeline.recording.records import ENCODING, FACTS, IMAGE, READ, message_of, output_of
from pipeline.text import harmless
from pipeline.version import described

MOST_MESSAGES = 20_000_000
KEPT_CHUNKS = 8
# what decoding raises: text that is no UTF-8 is a ValueError, deep nesting a RecursionError
UNREADABLE = (msgspec.MsgspecError, ValueError, RecursionError)
REPEATED = ("accounts", "settings")  # an hour of them needs hundreds of megabytes
Exposure = tuple[str, int]  # stream, seq
_Place = tuple[int, int]  # position of the chunk in the file, and of the message in the chunk


class Recording:
    """A recording; `broken` says, without its path, how it is cut or damaged; empty: it is whole.

    What is behind the damage is not read.
    """

    def __init__(self, path: Path) -> None:
        """Raises `RunError` for a file that is no recording of fovea."""
        self.path, self._file = path, McapChunks(path)
        # by node.output: where the message is, and the image before it if it has one
        self.messages: dict[str, dict[Exposure, tuple[_Place, _Place | None]]] = {}
        self.schemas: dict[str, str] = {}  # names of messages by node.output
        # by name, oldest first; of those that repeat what they say every second, the newest alone
        self.facts: dict[str, list[dict[str, Any]]] = {}
        self.exposures: dict[Exposure, int] = {}  # wall clock of the first message, in order
        self._same: dict[Exposure, Exposure] = {}  # one object of each for all outputs
        self._images: dict[str, _Place] = {}  # the last of each channel, while scanning
        count = 0
        for place, items in self._file.scan():
            count += len(items)
            if count > MOST_MESSAGES:
                raise RunError(f"{path}: expected up to {MOST_MESSAGES} messages, got more")
            for index, item in enumerate(items):
                self._index(item, (place, index))
        self.broken = self._file.broken
        if not self.messages and not self.facts:
            got = f"none of its messages{and_broken(self.broken)}"
            raise RunError(f"{path}: expected a recording of fovea, got {got}")
        self._chunk = lru_cache(KEPT_CHUNKS)(self._file.at)

    def message(self, output: str, cls: type[Message], exposure: Exposure) -> Message | None:
        """Return the message of `node.output` for an exposure, without its trace; None: there is
        none. Raises `MessageError` when it cannot be decoded.
        """
        found = self.messages.get(output, {}).get(exposure)
        if found is None:
            return None
        place, image = found
        item = self._item(place)
        try:
            record = READ.decode(item.data)
        except UNREADABLE as error:
            raise MessageError(f"{self.path}: {output}: frame {exposure[1]}: {error}") from error
        picture = self._item(image).data if image else None
        try:
            message = message_of(cls, record, picture)
        except MessageError as error:
            where = f"{self.path}: {output}: frame {exposure[1]}"
            raise MessageError(f"{where}: {error}{self._versions()}") from error
        return altered(message, header=altered(message.header, trace=(), epoch=0))

    def newest(self, name: str) -> dict[str, Any]:
        """Return the newest fact of a name; empty for none."""
        found = self.facts.get(name)
        return found[-1] if found else {}

    def _versions(self) -> str:
        """Return what wrote the file and what reads it, where they differ, as a clause."""
        wrote, reads = self.newest("graph").get("version"), described()
        if not wrote or wrote == reads:
            return ""
        return f"; recorded by fovea {harmless(str(wrote), 100)}, read by {reads}"

    def _item(self, place: _Place) -> Item:
        return self._chunk(place[0])[place[1]]

    def _index(self, item: Item, place: _Place) -> None:
        name = item.topic.name
        if name.startswith(FACTS):
            value = _json(item.data)
            if isinstance(value, dict):
                found = self.facts.setdefault(name.removeprefix(FACTS), [])
                if name.removeprefix(FACTS) in REPEATED:
                    found.clear()
                found.append(value)
        elif name.endswith(IMAGE) and item.topic.encoding != ENCODING:
            self._images[name] = place
        elif item.topic.encoding == ENCODING:
            try:
                record = READ.decode(item.data)
            except UNREADABLE:
                return
            exposure = (record.stream, record.seq)
            exposure = self._same.setdefault(exposure, exposure)
            image = self._images.get(name + IMAGE) if record.beside else None
            self.messages.setdefault(output_of(name), {})[exposure] = place, image
            self.schemas[output_of(name)] = item.topic.schema_name
            self.exposures.setdefault(exposure, item.log_ns)


def and_broken(broken: str) -> str:
    """Return that a file is cut or damaged as a clause behind what it lacks; empty: it is whole."""
    return f"; it {broken}" if broken else ""


class End(msgspec.Struct, frozen=True):
    """What the recorder wrote at the end of a file."""

    accounts: dict[str, dict[str, int]]  # counts by output since the recorder was begun
    file: int = 0  # its number among those of this recorder, from 1


def end_of(path: Path) -> End | None:
    """Return what the recorder wrote at the end of a file; None: it did not."""
    try:
        return msgspec.json.decode(last(path, f"{FACTS}end"), type=End)
    except UNREADABLE:
        return None


def _json(data: bytes) -> Any:
    try:
        return msgspec.json.decode(data)
    except UNREADABLE:
        return None
