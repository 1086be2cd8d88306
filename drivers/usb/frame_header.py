"""What precedes the pixels of each frame on a bulk end point."""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from drivers.usb.block import body_of, member, packed
from drivers.usb.errors import BadBlock

HEADER_BYTES = 96
MOST_PAYLOAD_BYTES = 1 << 30

Window = tuple[int, int, int, int]  # xyxy, sensor pixels


class Stream(IntEnum):
    """The streams, in the order of the bulk IN end points."""

    CONTEXT = 0
    ROI = 1


class FrameFlag(IntFlag):
    """Flags of a frame header."""

    RECORDED = 1  # part of a burst, downloaded after it
    ALONE = 2  # no ROI belongs to this context frame
    PAYLOAD_CRC = 4  # the header holds the payload's CRC
    INCOMPLETE = 8  # the sensor delivered less than the frame
    END = 16  # no further frame until the next START; the payload is empty


class WindowStatus(IntEnum):
    """Why the ROI lies where it lies."""

    OK = 0
    UNPLANNED = 1  # no schedule covered the exposure: the last window was kept
    STALE = 2  # the schedule that covers it came too late


@dataclass(frozen=True, kw_only=True)
class FrameHeader:
    """What precedes the pixels of one stream of one exposure."""

    stream: Stream
    flags: FrameFlag
    window_status: WindowStatus
    exposure: int
    stamp_ns: int  # board's clock, when the picture was ready
    window: Window  # the region that the pixels show
    size_px: tuple[int, int]  # of the picture: width, height
    pixel_format: int  # PFNC code
    row_bytes: int
    payload_bytes: int
    payload_crc: int  # with the flag PAYLOAD_CRC
    schedule_id: int  # that set the window; 0: none
    entry: int
    dropped: int  # frames of this stream that no host read in time, since START

    _BODY = struct.Struct("<BBBxxxxxQQHHHHHHIIIIIHxxI20x")
    _MAGIC = 0x52465646  # FVFR

    def pack(self) -> bytes:
        """Return the block of `HEADER_BYTES`."""
        body = self._BODY.pack(
            self.stream, self.flags, self.window_status, self.exposure, self.stamp_ns,
            *self.window, *self.size_px, self.pixel_format, self.row_bytes, self.payload_bytes,
            self.payload_crc, self.schedule_id, self.entry, self.dropped,
        )  # fmt: skip
        return packed(self._MAGIC, body)

    @classmethod
    def unpack(cls, block: bytes) -> "FrameHeader":
        """Return the header; raises `BadBlock`."""
        body = body_of(block, cls._MAGIC, cls._BODY.size, "frame header")
        (
            stream, flags, status, exposure, stamp_ns, left, top, right, bottom, width, height,
            code, row_bytes, payload_bytes, crc, schedule_id, entry, dropped,
        ) = cls._BODY.unpack_from(body)  # fmt: skip
        if flags > sum(FrameFlag) or payload_bytes != row_bytes * height:
            raise BadBlock("frame header: unknown flags, or a payload that is not its rows")
        if payload_bytes > MOST_PAYLOAD_BYTES or left > right or top > bottom:
            raise BadBlock("frame header: a payload of more than 1 GiB, or no window")
        return cls(
            stream=member(Stream, stream, "frame header"), flags=FrameFlag(flags),
            window_status=member(WindowStatus, status, "frame header"), exposure=exposure,
            stamp_ns=stamp_ns, window=(left, top, right, bottom), size_px=(width, height),
            pixel_format=code, row_bytes=row_bytes, payload_bytes=payload_bytes, payload_crc=crc,
            schedule_id=schedule_id, entry=entry, dropped=dropped,
        )  # fmt: skip
