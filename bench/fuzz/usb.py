"""Malformed blocks from a USB board: changed ones are refused, or sound with a right checksum.

A third of the changed blocks get a new, right checksum, as from firmware with a mistake. What is
then accepted has to be in bounds and come back as it went.
"""

import random
import struct
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from bench.fuzz import nasty
from bench.fuzz.tally import Tally, Watch
from drivers.usb.capabilities import BoardCapabilities, CaptureMode, RoiSize
from drivers.usb.frame_header import (
    MOST_PAYLOAD_BYTES,
    FrameFlag,
    FrameHeader,
    Stream,
    WindowStatus,
)
from drivers.usb.requests import (
    Acknowledgement,
    Answer,
    BoardStatus,
    BoardTime,
    Configuration,
    Fault,
    Schedule,
    State,
)

RESUMMED = 1 / 3  # share of cases with a right checksum


def fuzz_usb(count: int, *, seed: int = 0) -> Tally:
    """Read `count` malformed blocks."""
    rng, tally, cases = random.Random(seed), Tally(), list(blocks().values())
    watch = Watch()
    for _ in range(count):
        block = rng.choice(cases)
        data, resummed = _changed(block.pack(), rng)
        read = type(block).unpack if rng.random() < 0.9 else type(rng.choice(cases)).unpack
        watch.on = True
        tally.check(data.hex(), partial(_read, read, data, block.pack(), resummed))
        watch.on = False
    return tally.with_touched(watch.touched)


def blocks() -> Mapping[str, Any]:
    """Return one block of each kind that crosses the link, by name."""
    found = (
        FrameHeader(
            stream=Stream.ROI, flags=FrameFlag.PAYLOAD_CRC, window_status=WindowStatus.OK,
            exposure=7, stamp_ns=1 << 40, window=(0, 0, 4080, 2296), size_px=(4080, 2296),
            pixel_format=0x01080009, row_bytes=4080, payload_bytes=4080 * 2296, payload_crc=1,
            schedule_id=2, entry=3, dropped=0,
        ),
        Acknowledgement(schedule_id=2, answer=Answer.ACCEPTED, first_entry=0, next_exposure=8),
        Schedule(schedule_id=2, first=8, made_from=7, corners=((0, 0), (2, 2))),
        BoardTime(now_ns=1 << 40, next_exposure=8),
        BoardStatus(state=State.LIVE, fault=Fault.NONE, next_exposure=8, dropped=(0, 1)),
        Configuration(rate_mhz=30_000, roi_px=(4080, 2296), pixel_format=0x01080009),
        BoardCapabilities(
            width_px=16_320, height_px=9_184, context_px=(2040, 1148), step_px=2, lead_frames=1,
            modes=(CaptureMode.LIVE,), rates_mhz=(1000, 30_000), preview_mhz=0, burst_frames=0,
            link_bytes_per_s=0, roi_sizes=(RoiSize(4080, 2296),), formats=(0x01080009,),
        ),
    )  # fmt: skip
    return {type(block).__name__: block for block in found}


def _changed(data: bytes, rng: random.Random) -> tuple[bytes, bool]:
    if rng.random() < 0.1:
        return rng.randbytes(rng.randrange(200)), False
    changed = nasty.flipped(data, rng)
    if rng.random() >= RESUMMED or len(changed) < 12:
        return changed, False
    body = changed[:6] + struct.pack("<H", len(changed)) + changed[8:-4]
    return body + struct.pack("<I", zlib.crc32(body)), True


def _read(read: Callable[[bytes], Any], data: bytes, original: bytes, resummed: bool) -> None:
    found = read(data)
    if not resummed and data[: len(original)] != original:
        raise AssertionError(f"a changed block was accepted: {found}")
    if type(found).unpack(found.pack()) != found:
        raise AssertionError(f"it does not come back as it went: {found}")
    if isinstance(found, FrameHeader) and found.payload_bytes > MOST_PAYLOAD_BYTES:
        raise AssertionError(f"a payload of {found.payload_bytes} bytes")
