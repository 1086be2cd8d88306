"""Blocks of the wire protocol come back as they went and lie where PROTOCOL.md says.

Bytes of any kind are a block or refused in one sentence.
"""

import re
import struct
import zlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.fuzz.usb import blocks
from drivers import usb
from drivers.usb.block import VERSION
from drivers.usb.capabilities import BoardCapabilities
from drivers.usb.errors import BadBlock
from drivers.usb.frame_header import HEADER_BYTES, FrameHeader
from drivers.usb.requests import Schedule

BLOCKS = list(blocks().values())
VALUES = {  # of the fields that PROTOCOL.md names
    "Capabilities": {
        "width_px": 16_320, "height_px": 9_184, "context_width_px": 2040,
        "context_height_px": 1148, "step_px": 2, "lead_frames": 3, "modes": 3, "roi_sizes": 2,
        "formats": 2, "lowest_rate_mhz": 1000, "highest_rate_mhz": 30_000, "preview_mhz": 7500,
        "burst_frames": 105, "link_bytes_per_s": 400_000_000, "model": b"board", "serial": b"S1",
        "firmware": b"2.1",
    },
    "Configuration": {
        "rate_mhz": 30_000, "roi_width_px": 4080, "roi_height_px": 2296,
        "pixel_format": 0x01080009, "mode": 1, "payload_crc": 1, "burst_frames": 105,
        "context_bytes": 2_341_920, "roi_bytes": 9_367_680,
    },
    "Schedule": {"schedule_id": 7, "first": 1001, "made_from": 1000, "entries": 2},
    "Acknowledgement": {"schedule_id": 7, "answer": 1, "first_entry": 3, "next_exposure": 1004},
    "Time": {"now_ns": 1 << 40, "next_exposure": 12},
    "Status": {
        "state": 3, "fault": 2, "next_exposure": 99, "dropped_context": 5, "dropped_roi": 6,
    },
    "Frame header": {
        "stream": 1, "flags": 5, "window_status": 2, "exposure": 1 << 33, "stamp_ns": 1 << 41,
        "left_px": 16, "top_px": 18, "right_px": 4096, "bottom_px": 2314,
        "picture_width_px": 4080, "picture_height_px": 2296, "pixel_format": 0x01080009,
        "row_bytes": 4080, "payload_bytes": 4080 * 2296, "payload_crc": 0xDEADBEEF,
        "schedule_id": 41, "entry": 17, "dropped": 3,
    },
}  # fmt: skip
TYPES = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q"}


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: type(block).__name__)
def test_a_block_comes_back_as_it_went(block: Any) -> None:
    assert type(block).unpack(block.pack()) == block


@pytest.mark.parametrize("title", VALUES)
def test_every_field_lies_where_the_document_says(title: str) -> None:
    text = (Path(usb.__file__).parent / "PROTOCOL.md").read_text()
    section = re.split(r"^### ", text, flags=re.M)
    table = next(part for part in section if part.startswith(title))
    magic = table.split("`")[1].encode()
    block = dict(zip(VALUES, [*BLOCKS], strict=True))[title].pack()
    rows = re.findall(r"^\| (\d+) \| (\S+) \| (\w+) \|", table, flags=re.M)

    found = {}
    for offset, kind, name in rows:
        if kind in TYPES:
            found[name] = struct.unpack_from(f"<{TYPES[kind]}", block, int(offset))[0]
        elif kind.startswith("char"):
            length = int(kind[5:-1])
            found[name] = block[int(offset) : int(offset) + length].rstrip(b"\0")

    assert block[:4] == magic
    assert {name: found.get(name) for name in VALUES[title]} == VALUES[title]


def test_the_header_of_a_frame_has_the_length_that_the_document_says() -> None:
    assert len(blocks()["FrameHeader"].pack()) == HEADER_BYTES == 96


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: type(block).__name__)
@given(data=st.data())
def test_a_block_with_a_wrong_byte_is_refused(block: Any, data: st.DataObject) -> None:
    packed = bytearray(block.pack())
    place = data.draw(st.integers(0, len(packed) - 1))
    packed[place] ^= data.draw(st.integers(1, 255))

    with pytest.raises(BadBlock) as refusal:
        type(block).unpack(bytes(packed))

    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: type(block).__name__)
@given(body=st.binary(max_size=200), right=st.booleans())
def test_bytes_of_any_kind_are_refused_or_a_block(block: Any, body: bytes, right: bool) -> None:
    if right:  # a valid frame around any body
        head = struct.pack("<4sHH", block.pack()[:4], VERSION, len(body) + 12) + body
        body = head + struct.pack("<I", zlib.crc32(head))

    try:
        found = type(block).unpack(body)
    except BadBlock as refusal:
        assert "\n" not in str(refusal)  # noqa: PT017 - either outcome is right
    else:
        assert type(block).unpack(found.pack()) == found


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: type(block).__name__)
def test_a_longer_block_of_a_later_version_is_read_as_far_as_known(block: Any) -> None:
    packed = block.pack()
    if isinstance(block, BoardCapabilities | Schedule | FrameHeader):
        longer = packed[8:-4] + bytes(4)
    else:
        longer = packed[8:-4] + b"more"
    head = packed[:4] + struct.pack("<HH", VERSION, len(longer) + 12) + longer

    assert type(block).unpack(head + struct.pack("<I", zlib.crc32(head))) == block
