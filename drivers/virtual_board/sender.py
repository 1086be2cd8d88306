"""Frames of a started virtual board on their way to the host: bulk reads in, bytes out."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.usb.capabilities import BoardCapabilities, RoiSize
from drivers.usb.frame_header import FrameFlag, FrameHeader, Stream, Window, WindowStatus
from drivers.usb.requests import Configuration
from drivers.virtual_board.errors import Halted, TooMuch
from drivers.virtual_board.exposures import Exposed, Exposures
from drivers.virtual_board.faults import FaultScript
from drivers.virtual_board.world import World


@dataclass
class _Sending:
    """The frame that an end point is sending."""

    header: bytes
    payload: NDArray[np.uint8]
    sent: int = -1  # bytes of the payload; -1: not even the header
    ends_at: int = 0
    halts_at: int = -1
    truncated: bool = False
    overflows: bool = False


class FrameSender:
    """Renders the frames that wait when the host reads them, and sends them piece by piece."""

    def __init__(
        self, can: BoardCapabilities, configuration: Configuration, exposures: Exposures,
        world: World, faults: FaultScript, now_ns: Callable[[], int],
    ) -> None:  # fmt: skip
        self._can, self._configuration, self._world = can, configuration, world
        self._exposures, self._faults, self._now_ns = exposures, faults, now_ns
        self._sending: dict[Stream, _Sending | None] = dict.fromkeys(Stream)
        self._halted: set[Stream] = set()

    def send(self, stream: Stream, memory: NDArray[np.uint8]) -> int | None:
        """Send the next bytes of a stream; return their count, None where there are none now.

        Raises `Halted` or `TooMuch`.
        """
        if stream in self._halted:
            raise Halted(stream.name)
        sending = self._sending[stream] or self._begin(stream)
        if sending is None:
            return None
        if sending.sent < 0:
            return self._send_header(stream, sending, memory)
        if sending.sent <= sending.halts_at < sending.sent + len(memory):
            self._halted.add(stream)
            raise Halted(stream.name)
        if sending.overflows:
            self._sending[stream] = None
            raise TooMuch(stream.name)
        count = min(len(memory), sending.ends_at - sending.sent)
        copy_bytes(sending.payload, sending.sent, memory[:count])
        sending.sent += count
        # a read that the end fills exactly does not show it: the next one gets an empty packet
        if sending.sent == sending.ends_at and not (sending.truncated and count == len(memory)):
            self._sending[stream] = None
        return count

    def _send_header(self, stream: Stream, sending: _Sending, memory: NDArray[np.uint8]) -> int:
        if len(memory) < len(sending.header):
            self._sending[stream] = None
            raise TooMuch(stream.name)
        memory[: len(sending.header)] = np.frombuffer(sending.header, np.uint8)
        sending.sent = 0
        if not sending.ends_at:
            self._sending[stream] = None
        return len(sending.header)

    def _begin(self, stream: Stream) -> _Sending | None:
        """Render the next frame that can be read; None: there is none now."""
        running = self._exposures
        waiting = running.waiting[stream]
        while waiting and waiting[0].ready_ns <= self._now_ns():
            found = waiting.popleft()
            if self._faults.due("skip", found.exposure, stream.name.lower()) is None:
                self._sending[stream] = self._rendered(stream, found, running.dropped[stream])
                return self._sending[stream]
        if running.over and not waiting:
            nothing = np.empty(0, np.uint8)
            header = self._header(stream, None, running.dropped[stream], nothing)
            self._sending[stream] = _Sending(header.pack(), nothing)
            return self._sending[stream]
        return None

    def _rendered(self, stream: Stream, found: Exposed, dropped: int) -> _Sending:
        size = self._configuration.context_bytes, self._configuration.roi_bytes
        window = self._whole() if stream is Stream.CONTEXT else found.window
        payload = self._world.payload(
            found.exposure, window, self._size_px(stream), size[stream], int(stream)
        )
        header = self._header(stream, found, dropped, payload).pack()
        return self._spoiled(stream, found, _Sending(header, payload, ends_at=payload.size))

    def _spoiled(self, stream: Stream, found: Exposed, sending: _Sending) -> _Sending:
        """Let go wrong what the script says."""
        name, k, half = stream.name.lower(), found.exposure, sending.ends_at // 2
        if self._faults.due("corrupt_header", k, name):
            sending.header = (
                bytes([*sending.header[:20], sending.header[20] ^ 4]) + sending.header[21:]
            )
        if self._faults.due("corrupt_payload", k, name):
            # a copy, as a world may send the same bytes again
            sending.payload = np.array(sending.payload).reshape(-1)
            sending.payload[half] ^= 4
        if self._faults.due("truncate", k, name):
            sending.ends_at, sending.truncated = half, True
        if self._faults.due("stall", k, name):
            sending.halts_at = half
        sending.overflows = self._faults.due("overflow", k, name) is not None
        return sending

    def _header(
        self,
        stream: Stream,
        found: Exposed | None,
        dropped: int,
        payload: NDArray[np.uint8],
    ) -> FrameHeader:
        flags, crc = FrameFlag(0), 0
        if found is None:
            flags |= FrameFlag.END
        elif self._configuration.payload_crc:
            flags, crc = (
                flags | FrameFlag.PAYLOAD_CRC,
                zlib.crc32(np.ascontiguousarray(payload).data),
            )
        if found is not None and (found.alone or not any(self._configuration.roi_px)):
            flags |= FrameFlag.ALONE
        if found is not None and found.recorded:
            flags |= FrameFlag.RECORDED
        size_px = self._size_px(stream) if found is not None else (0, 0)
        window = (0, 0, 0, 0) if found is None else found.window
        rows = payload.size // size_px[1] if size_px[1] else 0
        shown = self._whole() if found and stream is Stream.CONTEXT else window
        return FrameHeader(
            stream=stream, flags=flags,
            window_status=found.status if found else WindowStatus.OK,
            exposure=found.exposure if found else self._exposures.next,
            stamp_ns=found.stamp_ns if found else self._now_ns(),
            window=shown, size_px=size_px, pixel_format=self._world.code(shown, size_px),
            row_bytes=rows,
            payload_bytes=payload.size, payload_crc=crc,
            schedule_id=found.schedule_id if found else 0, entry=found.entry if found else 0,
            dropped=dropped,
        )  # fmt: skip

    def clear_halt(self, stream: Stream) -> None:
        """Clear the halt of an end point: what follows is a header."""
        self._halted.discard(stream)
        self._sending[stream] = None

    def _whole(self) -> Window:
        return 0, 0, self._can.width_px, self._can.height_px

    def _size_px(self, stream: Stream) -> tuple[int, int]:
        if stream is Stream.CONTEXT:
            return self._can.context_px
        return picture_px(self._can, self._configuration.roi_px)


def copy_bytes(payload: NDArray[np.uint8], start: int, out: NDArray[np.uint8]) -> None:
    """Fill `out` (n,) with the bytes of a payload (bytes,) or (rows, row_bytes) from `start` on.

    >>> out = np.empty(4, np.uint8)
    >>> copy_bytes(np.arange(12, dtype=np.uint8).reshape(4, 3)[:, :2], 1, out)
    >>> out.tolist()
    [1, 3, 4, 6]
    """
    if payload.ndim == 1:
        out[:] = payload[start : start + len(out)]
        return
    width = payload.shape[1]
    row, column = divmod(start, width)
    done = min(-column % width, len(out))  # the rest of a row that was begun
    out[:done] = payload[row, column : column + done] if done else ()
    row += bool(column)
    whole = (len(out) - done) // width
    out[done : done + whole * width].reshape(whole, width)[:] = payload[row : row + whole]
    done += whole * width
    if done < len(out):
        out[done:] = payload[row + whole, : len(out) - done]


def picture_px(can: BoardCapabilities, roi_px: tuple[int, int]) -> tuple[int, int]:
    """Return width and height of the picture of a window of this size."""
    sizes = {(size.width_px, size.height_px): size for size in can.roi_sizes}
    size = sizes.get(roi_px, RoiSize(0, 0))
    return size.width_px // size.binning, size.height_px // size.binning
