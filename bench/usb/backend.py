"""A virtual board on a bus of its own whose pictures are prepared, and which writes down its work.

Names as `backend` of `DualStreamBoard`: the driver above it is the one that runs on a real board.
"""

import ctypes
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.usb.gauge import GaugedBoard, spread
from bench.usb.paced import PacedLink
from bench.usb.places import Places
from bench.usb.ring import BlankWorld, Prepared, RingWorld, prepared
from drivers.usb.errors import BadBlock
from drivers.usb.frame_header import HEADER_BYTES, FrameHeader, Stream
from drivers.usb.link import MOST_IN_FLIGHT
from drivers.virtual_board.backend import VirtualBackend, VirtualBoardSettings
from drivers.virtual_board.descriptors import ENDPOINTS
from drivers.virtual_board.profiles import Profile
from drivers.virtual_board.world import World
from pipeline.errors import SettingsError
from pipeline.pixel_formats import BY_CODE
from pipeline.whole_file import write_whole

MOST_FRAMES = 100_000  # whose places are written down


@dataclass(frozen=True, kw_only=True)
class RingSettings(VirtualBoardSettings):
    """Which board is attached, and how many pictures it has."""

    profile: str = "paper-live"
    scene: str = "soccer"
    ring: int = 4  # pictures, 150 MB each at 8 bit of the paper's size; 0: black ones
    reads: int = 16  # in flight, as the link is modelled
    unlimited: bool = False  # any rate, and a link that takes no time
    log: str = ""  # file for the figures when the board is closed; empty: none

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.ring <= 64:
            raise SettingsError(f"ring: expected 0 to 64, got {self.ring}")
        if not 1 <= self.reads <= MOST_IN_FLIGHT:
            raise SettingsError(f"reads: expected 1 to {MOST_IN_FLIGHT}, got {self.reads}")

    def scaled(self) -> Profile:
        """Return the profile with the size of the sensor, and without limits where asked for.

        It is never paced: this board has a link of its own.
        """
        found = replace(super().scaled(), paced=False)
        if not self.unlimited:
            return found
        can = replace(found.can, rates_mhz=(100, 1_000_000), link_bytes_per_s=0)
        return replace(found, can=can)


class RingBoard(GaugedBoard):
    """A gauged board before prepared pictures."""

    def __init__(self, settings: RingSettings) -> None:
        self._settings = settings
        self._rings: dict[int, list[Prepared]] = {}
        super().__init__(settings.scaled(), self._opened)
        limit = self.profile.can.link_bytes_per_s
        self._paced = PacedLink(limit, settings.reads) if limit else None

    def carry(self, sent: NDArray[np.uint8], asked_ns: int) -> None:
        """Take the time of so many bytes."""
        if self._paced is not None:
            self._paced.carry(len(sent), asked_ns=asked_ns, ready_ns=self._ready_ns(sent))

    def figures(self) -> dict[str, Any]:
        """Return what the board cost, and how long its link waited for a read."""
        found = self.gauge.figures()
        gaps = self._paced.gaps_ms() if self._paced is not None else ()
        waits = round(sum(gaps) / 10 / max(1e-9, found["seconds"]), 2)
        named = {f"gap_{name}_ms": value for name, value in spread(gaps).items()}
        return {**found, "link_waits_percent": waits, **named}

    def _ready_ns(self, sent: NDArray[np.uint8]) -> int:
        """When a header could be sent, in `time.monotonic_ns()`; 0 for the pixels behind it."""
        if len(sent) != HEADER_BYTES:
            return 0
        header = FrameHeader.unpack(sent.tobytes())
        readout_ns = self.profile.readout_frames * 1e12 / self._configuration.rate_mhz
        return round(header.stamp_ns + readout_ns) - self._now_ns() + time.monotonic_ns()

    def _opened(self, code: int, _most_px: int) -> World:
        form, can = BY_CODE[code], self.profile.can
        if not self._settings.ring:
            return BlankWorld(form)
        if code not in self._rings:  # only the newest: they are large
            sizes = (can.width_px, can.height_px), can.context_px
            count, seed = self._settings.ring, self._settings.seed
            self._rings = {code: prepared(form, *sizes, count=count, seed=seed)}
        return RingWorld(form, self._rings[code])


class RingBackend(VirtualBackend):
    """A gauged board as a backend of pyusb; writes down where every frame was put."""

    settings_type = RingSettings

    def __init__(self, settings: RingSettings) -> None:
        self._gauged = RingBoard(settings)
        super().__init__(settings, board=self._gauged)
        self._log = settings.log
        self._puts = Puts()

    def bulk_read(
        self, dev_handle: SimpleNamespace, ep: int, intf: int, buff: Any, timeout: int
    ) -> int:
        """Read, and note where to."""
        count = super().bulk_read(dev_handle, ep, intf, buff, timeout)
        if self._log:
            stream = Stream([e["bEndpointAddress"] for e in ENDPOINTS].index(ep))
            self._puts.note(stream, buff.buffer_info()[0], count)
        return count

    def close_device(self, dev_handle: SimpleNamespace) -> None:
        """Close, and write the figures so far."""
        super().close_device(dev_handle)
        if self._log:
            found = {"board": self._gauged.figures(), "frames": self._puts.frames}
            write_whole(Path(self._log), json.dumps(found))


class Puts:
    """Where the payload of each frame was put by bulk reads.

    `frames` has (stream, exposure, place of the first byte, bytes that followed one another there).
    """

    def __init__(self) -> None:
        self.frames: list[tuple[str, int, str, int]] = []
        self._places = Places()
        self._coming: dict[Stream, FrameHeader] = {}
        self._begin: dict[Stream, int] = {}
        self._count: dict[Stream, int] = {}

    def note(self, stream: Stream, address: int, count: int) -> None:
        """Note one read of `count` bytes to an address."""
        header = self._coming.get(stream)
        if header is None:
            self._note_header(stream, address, count)
            return
        begin = self._begin.setdefault(stream, address)
        if address == begin + self._count[stream]:
            self._count[stream] += count
        if self._count[stream] == header.payload_bytes:
            self._end(stream, header)

    def _note_header(self, stream: Stream, address: int, count: int) -> None:
        try:
            header = FrameHeader.unpack(ctypes.string_at(address, count)[-HEADER_BYTES:])
        except BadBlock:
            return
        if header.payload_bytes:
            self._coming[stream], self._count[stream] = header, 0

    def _end(self, stream: Stream, header: FrameHeader) -> None:
        place = self._places.of(self._begin.pop(stream))
        if len(self.frames) < MOST_FRAMES:
            name = stream.name.lower()
            self.frames.append((name, header.exposure, place, self._count[stream]))
        del self._coming[stream]
