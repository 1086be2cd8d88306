"""The vendor requests to the board's interface and the blocks that travel with them."""

import struct
from dataclasses import dataclass
from enum import IntEnum

from drivers.usb.block import body_of, member, packed
from drivers.usb.capabilities import CaptureMode
from drivers.usb.errors import BadBlock
from drivers.usb.frame_header import MOST_PAYLOAD_BYTES

MOST_ENTRIES = 960  # windows of one schedule in a control transfer


class Request(IntEnum):
    """`bRequest` of the vendor requests to the interface."""

    CAPABILITIES = 0x10
    CONFIGURE = 0x11
    CONFIGURATION = 0x12
    START = 0x13
    STOP = 0x14
    SCHEDULE = 0x15
    ACKNOWLEDGEMENT = 0x16
    TIME = 0x17
    STATUS = 0x18
    TRIGGER = 0x19


class Answer(IntEnum):
    """What became of a schedule."""

    ACCEPTED = 0
    PARTLY_LATE = 1  # its first entries are past
    LATE = 2  # all of its entries are past
    REFUSED = 3  # a window out of bounds or off the grid, too many entries
    NONE = 4  # no schedule since START


class State(IntEnum):
    """What the board is doing."""

    IDLE = 0
    LIVE = 1
    PREVIEW = 2
    RECORDING = 3
    DOWNLOADING = 4


class Fault(IntEnum):
    """Error of the board itself."""

    NONE = 0
    SENSOR = 1
    MEMORY = 2
    TEMPERATURE = 3


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """What the host asks for, or, with the sizes of the payloads, what is in effect."""

    rate_mhz: int
    roi_px: tuple[int, int]  # window, sensor pixels; (0, 0): no ROI
    pixel_format: int  # PFNC code of both streams
    mode: CaptureMode = CaptureMode.LIVE
    payload_crc: bool = False
    burst_frames: int = 0  # of a recording
    context_bytes: int = 0  # set by the board
    roi_bytes: int = 0

    _BODY = struct.Struct("<IHHIBBHII")
    _MAGIC = 0x47435646  # FVCG

    def pack(self) -> bytes:
        """Return the block."""
        body = self._BODY.pack(
            self.rate_mhz, *self.roi_px, self.pixel_format, self.mode, self.payload_crc,
            self.burst_frames, self.context_bytes, self.roi_bytes,
        )  # fmt: skip
        return packed(self._MAGIC, body)

    @classmethod
    def unpack(cls, block: bytes) -> "Configuration":
        """Return the configuration; raises `BadBlock`."""
        body = body_of(block, cls._MAGIC, cls._BODY.size, "configuration")
        rate, width, height, code, mode, crc, burst, context, roi = cls._BODY.unpack_from(body)
        if max(context, roi) > MOST_PAYLOAD_BYTES or not rate:
            raise BadBlock("configuration: no rate, or a payload of more than 1 GiB")
        return cls(
            rate_mhz=rate, roi_px=(width, height), pixel_format=code,
            mode=member(CaptureMode, mode, "configuration"), payload_crc=bool(crc & 1),
            burst_frames=burst, context_bytes=context, roi_bytes=roi,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Where the ROI lies from an exposure on: top left corners, one for each exposure."""

    schedule_id: int  # counts up from 1
    first: int  # exposure of the first corner
    made_from: int  # exposure that the plan was made from
    corners: tuple[tuple[int, int], ...]  # sensor pixels

    _BODY = struct.Struct("<IQQHxx")
    _MAGIC = 0x48535646  # FVSH

    def pack(self) -> bytes:
        """Return the block."""
        body = self._BODY.pack(self.schedule_id, self.first, self.made_from, len(self.corners))
        flat = [side for corner in self.corners for side in corner]
        return packed(self._MAGIC, body + struct.pack(f"<{len(flat)}H", *flat))

    @classmethod
    def unpack(cls, block: bytes) -> "Schedule":
        """Return the schedule; raises `BadBlock`."""
        body = body_of(block, cls._MAGIC, cls._BODY.size, "schedule")
        schedule_id, first, made_from, count = cls._BODY.unpack_from(body)
        if count > MOST_ENTRIES or len(body) < cls._BODY.size + 4 * count:
            raise BadBlock(f"schedule: {count} entries do not fit the block")
        flat = struct.unpack_from(f"<{2 * count}H", body, cls._BODY.size)
        corners = tuple(zip(flat[::2], flat[1::2], strict=True))
        return cls(schedule_id=schedule_id, first=first, made_from=made_from, corners=corners)


@dataclass(frozen=True, kw_only=True)
class Acknowledgement:
    """What became of the newest schedule."""

    schedule_id: int
    answer: Answer
    first_entry: int  # the first entry that is not past
    next_exposure: int

    _BODY = struct.Struct("<IHHQ")
    _MAGIC = 0x4B415646  # FVAK

    def pack(self) -> bytes:
        """Return the block."""
        return packed(
            self._MAGIC,
            self._BODY.pack(self.schedule_id, self.answer, self.first_entry, self.next_exposure),
        )

    @classmethod
    def unpack(cls, block: bytes) -> "Acknowledgement":
        """Return the acknowledgement; raises `BadBlock`."""
        body = body_of(block, cls._MAGIC, cls._BODY.size, "acknowledgement")
        schedule_id, answer, first_entry, following = cls._BODY.unpack_from(body)
        return cls(
            schedule_id=schedule_id,
            answer=member(Answer, answer, "acknowledgement"),
            first_entry=first_entry,
            next_exposure=following,
        )


@dataclass(frozen=True, kw_only=True)
class BoardTime:
    """The board's clock at the time of the request."""

    now_ns: int
    next_exposure: int

    _BODY = struct.Struct("<QQ")
    _MAGIC = 0x49545646  # FVTI

    def pack(self) -> bytes:
        """Return the block."""
        return packed(self._MAGIC, self._BODY.pack(self.now_ns, self.next_exposure))

    @classmethod
    def unpack(cls, block: bytes) -> "BoardTime":
        """Return the time; raises `BadBlock`."""
        body = body_of(block, cls._MAGIC, cls._BODY.size, "time")
        now_ns, following = cls._BODY.unpack_from(body)
        return cls(now_ns=now_ns, next_exposure=following)


@dataclass(frozen=True, kw_only=True)
class BoardStatus:
    """The board's state, for a host that has heard nothing."""

    state: State
    fault: Fault
    next_exposure: int
    dropped: tuple[int, int]  # frames of each stream that no host read in time, since START

    _BODY = struct.Struct("<BBxxQII")
    _MAGIC = 0x54535646  # FVST

    def pack(self) -> bytes:
        """Return the block."""
        return packed(
            self._MAGIC,
            self._BODY.pack(self.state, self.fault, self.next_exposure, *self.dropped),
        )

    @classmethod
    def unpack(cls, block: bytes) -> "BoardStatus":
        """Return the status; raises `BadBlock`."""
        body = body_of(block, cls._MAGIC, cls._BODY.size, "status")
        state, fault, following, context, roi = cls._BODY.unpack_from(body)
        return cls(
            state=member(State, state, "status"), fault=member(Fault, fault, "status"),
            next_exposure=following, dropped=(context, roi),
        )  # fmt: skip
