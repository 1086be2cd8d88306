"""What a board can do: its answer to the request CAPABILITIES."""

import struct
from dataclasses import dataclass
from enum import IntEnum

from drivers.usb.block import body_of, packed, text_of
from drivers.usb.errors import BadBlock


class CaptureMode(IntEnum):
    """What the board does between START and STOP."""

    LIVE = 0  # both streams of every exposure
    RECORD = 1  # preview of the context; a schedule starts a burst, which is downloaded afterwards


@dataclass(frozen=True)
class RoiSize:
    """A window that the sensor can read."""

    width_px: int  # sensor pixels
    height_px: int
    binning: int = 1  # sensor pixels per ROI pixel, along one side


@dataclass(frozen=True, kw_only=True)
class BoardCapabilities:
    """What a board can do. Rates are in millihertz."""

    width_px: int
    height_px: int
    context_px: tuple[int, int]  # width, height
    step_px: int  # windows start at multiples of it
    lead_frames: int
    modes: tuple[CaptureMode, ...]
    rates_mhz: tuple[int, int]  # lowest and highest
    preview_mhz: int  # of the context in record mode; 0: no record mode
    burst_frames: int
    link_bytes_per_s: int  # what the board can send
    roi_sizes: tuple[RoiSize, ...]  # at most 16
    formats: tuple[int, ...]  # PFNC codes, at most 32
    model: str = ""  # at most 24 bytes
    serial: str = ""
    firmware: str = ""

    _BODY = struct.Struct("<HHHHHHBBBxIIIHxxQ24s24s16s")
    _SIZE = struct.Struct("<HHBx")
    _MAGIC = 0x42435646  # FVCB

    def pack(self) -> bytes:
        """Return the block."""
        modes = sum(1 << mode for mode in self.modes)
        body = self._BODY.pack(
            self.width_px, self.height_px, *self.context_px, self.step_px, self.lead_frames,
            modes, len(self.roi_sizes), len(self.formats), *self.rates_mhz, self.preview_mhz,
            self.burst_frames, self.link_bytes_per_s, self.model.encode()[:24],
            self.serial.encode()[:24], self.firmware.encode()[:16],
        )  # fmt: skip
        sizes = [self._SIZE.pack(s.width_px, s.height_px, s.binning) for s in self.roi_sizes]
        codes = [struct.pack("<I", code) for code in self.formats]
        return packed(self._MAGIC, b"".join([body, *sizes, *codes]))

    @classmethod
    def unpack(cls, block: bytes) -> "BoardCapabilities":
        """Return the capabilities; raises `BadBlock`."""
        body = body_of(block, cls._MAGIC, cls._BODY.size, "capabilities")
        (
            width, height, context_width, context_height, step, lead, modes, sizes, formats,
            lowest, highest, preview, burst, link, *names,
        ) = cls._BODY.unpack_from(body)  # fmt: skip
        codes_at = cls._BODY.size + sizes * cls._SIZE.size
        if sizes > 16 or formats > 32 or len(body) < codes_at + 4 * formats:
            raise BadBlock("capabilities: its lists are longer than the block")
        found = cls(
            width_px=width, height_px=height, context_px=(context_width, context_height),
            step_px=step, lead_frames=lead,
            modes=tuple(mode for mode in CaptureMode if modes >> mode & 1),
            rates_mhz=(lowest, highest), preview_mhz=preview, burst_frames=burst,
            link_bytes_per_s=link,
            roi_sizes=tuple(
                RoiSize(*cls._SIZE.unpack_from(body, cls._BODY.size + k * cls._SIZE.size))
                for k in range(sizes)
            ),
            formats=struct.unpack_from(f"<{formats}I", body, codes_at),
            model=text_of(names[0]), serial=text_of(names[1]), firmware=text_of(names[2]),
        )  # fmt: skip
        found._check()
        return found

    def _check(self) -> None:
        sides = (self.width_px, self.height_px, *self.context_px, self.step_px)
        if not all(sides):
            raise BadBlock("capabilities: a side or the step is 0")
        if not 0 < self.rates_mhz[0] <= self.rates_mhz[1] or not self.formats or not self.modes:
            raise BadBlock("capabilities: no rate, no pixel format or no mode")
        for size in self.roi_sizes:
            inside = 0 < size.width_px <= self.width_px and 0 < size.height_px <= self.height_px
            if not inside or not size.binning or self._off_grid(size):
                raise BadBlock(f"capabilities: {size.width_px}x{size.height_px} is no ROI here")

    @staticmethod
    def _off_grid(size: RoiSize) -> bool:
        return bool(size.width_px % size.binning or size.height_px % size.binning)
