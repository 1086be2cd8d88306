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
    """Return one block of each kind that crosses the link, by name; no two fields are alike."""
    found = (
        BoardCapabilities(
            width_px=16_320, height_px=9_184, context_px=(2040, 1148), step_px=2, lead_frames=3,
            modes=(CaptureMode.LIVE, CaptureMode.RECORD), rates_mhz=(1000, 30_000),
            preview_mhz=7500, burst_frames=105, link_bytes_per_s=400_000_000,
            roi_sizes=(RoiSize(4080, 2296), RoiSize(8160, 4592, 2)),
            formats=(0x01080009, 0x02180014), model="board", serial="S1", firmware="2.1",
        ),
        Configuration(
            rate_mhz=30_000, roi_px=(4080, 2296), pixel_format=0x01080009,
            mode=CaptureMode.RECORD, payload_crc=True, burst_frames=105, context_bytes=2_341_920,
            roi_bytes=9_367_680,
        ),
        Schedule(schedule_id=7, first=1001, made_from=1000, corners=((2, 4), (6, 8))),
        Acknowledgement(
            schedule_id=7, answer=Answer.PARTLY_LATE, first_entry=3, next_exposure=1004
        ),
        BoardTime(now_ns=1 << 40, next_exposure=12),
        BoardStatus(
            state=State.RECORDING, fault=Fault.MEMORY, next_exposure=99, dropped=(5, 6)
        ),
        FrameHeader(
            stream=Stream.ROI, flags=FrameFlag.RECORDED | FrameFlag.PAYLOAD_CRC,
            window_status=WindowStatus.STALE, exposure=1 << 33, stamp_ns=1 << 41,
            window=(16, 18, 4096, 2314), size_px=(4080, 2296), pixel_format=0x01080009,
            row_bytes=4080, payload_bytes=4080 * 2296, payload_crc=0xDEADBEEF, schedule_id=41,
            entry=17, dropped=3,
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
