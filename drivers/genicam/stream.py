"""Buffers in flight between a camera and this process: frames out, as the camera filled them."""

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.genicam.aravis import library

CHUNKS = ("Timestamp", "OffsetX", "OffsetY")
COUNTED = {  # the library's name -> ours
    "n_underruns": "without_buffer",
    "n_missing_frames": "frames_missing",
    "n_missing_packets": "packets_missing",
    "n_resent_packets": "packets_resent",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrived:
    """One buffer as the camera filled it; its memory is valid until it is given back."""

    memory: NDArray[np.uint8]  # (bytes,), what was received
    status: str  # success, or why it is incomplete
    frame_id: int
    stamp_ns: int  # of the camera's clock; 0: it has none
    arrived_ns: int  # CLOCK_MONOTONIC
    width_px: int
    height_px: int
    offset_px: tuple[int, int]  # as the camera states it in the frame
    padding: int  # bytes after each row
    code: int  # PFNC pixel format
    chunks: Mapping[str, int] = field(default_factory=dict)
    handle: Any = None


class Stream:
    """Buffers that the camera fills while others are read; a frame is never copied."""

    def __init__(self, stream: Any, payload: int, buffers: int, parser: Any) -> None:
        self._stream, self._parser = stream, parser
        for _ in range(buffers):
            stream.push_buffer(library().aravis.Buffer.new_allocate(payload))

    def pop(self, timeout_s: float) -> Arrived | None:
        """The next buffer in the order of arrival; None: none in time."""
        if timeout_s > 0:
            buffer = self._stream.timeout_pop_buffer(round(timeout_s * 1e6))
        else:
            buffer = self._stream.try_pop_buffer()
        return None if buffer is None else self._arrived(buffer)

    def give_back(self, arrived: Arrived) -> None:
        """Let the camera fill the buffer again."""
        stream = self._stream
        if stream is not None:
            stream.push_buffer(arrived.handle)

    def figures(self) -> dict[str, int]:
        """What the library has counted, as far as there is something to tell."""
        stream, found = self._stream, {}
        for i in range(stream.get_n_infos()):
            name = stream.get_info_name(i)
            if name in COUNTED:
                found[COUNTED[name]] = int(stream.get_info_uint64(i))
        return found

    def close(self) -> None:
        """End the library's thread. Frames still held stay valid: they keep their buffer."""
        self._stream = None

    def _arrived(self, buffer: Any) -> Arrived:
        status = buffer.get_status().value_nick
        image = status == "success" and buffer.get_payload_type() in _image_payloads()
        if status == "success" and not image:
            status = "no-image"
        region = buffer.get_image_region() if image else (0, 0, 0, 0)
        behind_ns = time.time_ns() - time.monotonic_ns()
        return Arrived(
            memory=library().native.received(buffer),
            status=status,
            frame_id=buffer.get_frame_id(),
            stamp_ns=buffer.get_timestamp(),
            arrived_ns=buffer.get_system_timestamp() - behind_ns,
            offset_px=(region[0], region[1]),
            width_px=region[2],
            height_px=region[3],
            padding=buffer.get_image_padding()[0] if image else 0,
            code=buffer.get_image_pixel_format() if image else 0,
            chunks=self._chunks(buffer) if status == "success" else {},
            handle=buffer,
        )

    def _chunks(self, buffer: Any) -> dict[str, int]:
        if self._parser is None or not buffer.has_chunks():
            return {}
        found = {}
        for name in CHUNKS:
            with contextlib.suppress(library().error):
                found[name] = int(self._parser.get_integer_value(buffer, f"Chunk{name}"))
        return found


@cache
def _image_payloads() -> tuple[Any, ...]:
    kinds = library().aravis.BufferPayloadType
    return (kinds.IMAGE, kinds.EXTENDED_CHUNK_DATA)
