"""Frames out of a link: headers in step with their payloads, or the next header after a failure.

A header is a transfer of its own that ends short; its payload follows. Whatever does not fit this
is read away until a valid header ends a transfer, and what was lost is counted. While a frame is
read, reads of the next header are in flight behind it, and reads of the next payload where there is
memory for it: so the link does not wait while the host is busy with what it has.
"""

import zlib
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from drivers.usb.errors import BadBlock, LinkError, Overflow
from drivers.usb.frame_header import HEADER_BYTES, FrameFlag, FrameHeader, Stream
from drivers.usb.link import Link
from drivers.usb.losses import Losses
from drivers.usb.part import Part

PACKET_BYTES = 1024
SEARCH_BYTES = 64 << 10  # of one read while there is no header


class Receiver:
    """Both streams of a started board; used by one thread."""

    def __init__(self, link: Link, payload_bytes: Mapping[Stream, int], losses: Losses) -> None:
        self._link, self._payload_bytes, self.losses = link, payload_bytes, losses
        self._next = {stream: np.empty(SEARCH_BYTES, np.uint8) for stream in Stream}
        self._searching = dict.fromkeys(Stream, False)
        # what each stream sends next: parts that were begun, or will be read ahead
        self._coming: dict[Stream, deque[Part]] = {stream: deque() for stream in Stream}

    @property
    def exposure_bytes(self) -> int:
        """Pixels of both streams."""
        return sum(self._payload_bytes.values())

    def headers(self, streams: Sequence[Stream], timeout_s: float) -> dict[Stream, FrameHeader]:
        """Return the headers that came in time. Raises `LinkError` as the link does."""
        parts = {stream: self._header_part(stream) for stream in streams}
        self._receive(list(parts.values()), timeout_s)
        found = {}
        for stream, part in parts.items():
            if part.received:
                self._coming[stream].popleft()
                header = self._read(stream, part)
                if header is not None:
                    found[stream] = header
            elif part.short:  # an empty packet ended a payload
                self._lose_step(stream)
        return found

    def payloads(
        self,
        wanted: Sequence[tuple[FrameHeader, NDArray[np.uint8]]],
        timeout_s: float,
        ahead: Mapping[Stream, NDArray[np.uint8]] | None = None,
    ) -> bool:
        """Fill each memory (n,) with the payload of its header; False: one is incomplete.

        `ahead`: memory for the payloads of the next exposure, which is to be `wanted` then; None:
        read nothing ahead. It may be written from now on until `search` or another error.
        """
        parts = [self._payload_part(header.stream, memory) for header, memory in wanted]
        for part in parts if ahead is not None else ():
            self._coming[Stream(part.stream)].append(self._new_header_part(Stream(part.stream)))
        for stream, memory in (ahead or {}).items():
            self._coming[stream].append(Part(stream, memory))
        try:
            self._receive(parts, timeout_s)
        except Overflow as error:
            self._miss("overflow", f"exposure {wanted[0][0].exposure}: {error}", parts)
            return False
        for part in parts:
            self._coming[Stream(part.stream)].popleft()
        for (header, _), part in zip(wanted, parts, strict=True):
            if not part.full:
                got = f"expected {header.payload_bytes} bytes, got {part.received}"
                self._miss("incomplete", f"{_name(header)}: {got}", parts)
                return False
        return all(self._intact(header, memory) for header, memory in wanted)

    def skip(self, headers: Sequence[FrameHeader], timeout_s: float) -> None:
        """Read payloads away that nobody wants."""
        for header in headers:
            begun = self._coming[header.stream]
            if not begun:
                begun.append(Part(header.stream, np.empty(header.payload_bytes, np.uint8)))
            part = begun[0]
            try:
                self._receive([part], timeout_s)
            except Overflow as error:
                self._miss("overflow", f"{_name(header)}: {error}", [part])
                continue
            begun.popleft()
            if not part.full:
                self._lose_step(header.stream)

    def search(self) -> None:
        """Look for a header in what comes next: a halt has ended both frames."""
        for stream in Stream:
            self._lose_step(stream)

    def _receive(self, parts: Sequence[Part], timeout_s: float) -> None:
        """Receive parts, the first of their streams, and go on with what follows them."""
        # one of each stream in turn, so that no stream waits for reads that hold another's pixels
        turns = zip_longest(*self._coming.values())
        coming = [part for turn in turns for part in turn if part is not None]
        ahead = [part for part in coming if not any(part is one for one in parts)]
        try:
            self._link.receive(parts, timeout_s, ahead)
        except LinkError:
            self.search()  # what was read ahead is not in step any more
            raise

    def _lose_step(self, stream: Stream) -> None:
        """Give up what was read ahead of a stream, and look for its next header."""
        if self._coming[stream]:
            self._coming[stream].clear()
            self._link.cancel(stream)
        self._searching[stream] = True

    def _intact(self, header: FrameHeader, memory: NDArray[np.uint8]) -> bool:
        if FrameFlag.INCOMPLETE in header.flags:
            self.losses.lose("incomplete", f"{_name(header)}: the board has not all of it")
            return False
        checked = FrameFlag.PAYLOAD_CRC in header.flags
        if checked and (got := zlib.crc32(memory.data)) != header.payload_crc:
            said = f"expected the checksum {header.payload_crc:#010x}, got {got:#010x}"
            self.losses.lose("checksum", f"{_name(header)}: {said}")
            return False
        return True

    def _miss(self, reason: str, sentence: str, parts: Sequence[Part]) -> None:
        self.losses.lose(reason, sentence)
        for part in parts:
            if not part.full:
                self._lose_step(Stream(part.stream))

    def _header_part(self, stream: Stream) -> Part:
        """The first part of a stream that waits for a header."""
        coming = self._coming[stream]
        if not coming:
            coming.append(self._new_header_part(stream))
        return coming[0]

    def _new_header_part(self, stream: Stream) -> Part:
        size = SEARCH_BYTES if self._searching[stream] else PACKET_BYTES
        return Part(stream, self._next[stream][:size])

    def _payload_part(self, stream: Stream, memory: NDArray[np.uint8]) -> Part:
        """The first part of a stream whose header has come; reads into its memory may have begun.

        Raises `LinkError` where they were begun into other memory.
        """
        coming = self._coming[stream]
        if coming and coming[0].memory.ctypes.data != memory.ctypes.data:
            raise LinkError(f"{stream.name.lower()}: expected the memory that was given ahead")
        if not coming:
            coming.append(Part(stream, memory))
        return coming[0]

    def _read(self, stream: Stream, part: Part) -> FrameHeader | None:
        """Return the header that ends what was received; None: the search goes on."""
        block = part.memory[max(0, part.received - HEADER_BYTES) : part.received].tobytes()
        try:
            header = FrameHeader.unpack(block)
            if header.stream is not stream:
                raise BadBlock(f"frame header: of stream {header.stream.name}")
            expected = 0 if FrameFlag.END in header.flags else self._payload_bytes[stream]
            if header.payload_bytes != expected:
                got = header.payload_bytes
                raise BadBlock(f"frame header: expected {expected} bytes of pixels, got {got}")
        except BadBlock as error:
            if not self._searching[stream]:
                said = f"{stream.name.lower()}: looking for the next frame: {error}"
                self.losses.lose("header", said)
            self._lose_step(stream)
            return None
        self._searching[stream] = False
        return header


def _name(header: FrameHeader) -> str:
    return f"{header.stream.name.lower()} of exposure {header.exposure}"
