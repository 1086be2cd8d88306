"""The frame of every block of the wire protocol: a body in, checked bytes out, and back.

A block is little-endian: magic, version, size, body, CRC-32 of all that precedes it. A body that is
longer than this version knows is read as far as it is known.
"""

import struct
import zlib
from enum import IntEnum
from typing import TypeVar

from drivers.usb.errors import BadBlock

VERSION = 1
MOST_BLOCK_BYTES = 4096  # of a control transfer under Linux

_HEAD = struct.Struct("<IHH")  # magic, version, size of the whole block
_CRC = struct.Struct("<I")

E = TypeVar("E", bound=IntEnum)


def packed(magic: int, body: bytes) -> bytes:
    """Return the block around a body."""
    size = _HEAD.size + len(body) + _CRC.size
    if size > MOST_BLOCK_BYTES:
        raise BadBlock(f"a block of {size} bytes is longer than a control transfer")
    head = _HEAD.pack(magic, VERSION, size) + body
    return head + _CRC.pack(zlib.crc32(head))


def body_of(block: bytes, magic: int, least: int, what: str) -> bytes:
    """Return the checked body, of at least `least` bytes; raises `BadBlock`."""
    if len(block) < _HEAD.size + least + _CRC.size:
        raise BadBlock(f"{what}: expected at least {_HEAD.size + least + _CRC.size} bytes, "
                       f"got {len(block)}")  # fmt: skip
    found, version, size = _HEAD.unpack_from(block)
    if found != magic or version != VERSION:
        raise BadBlock(f"{what}: expected magic {magic:#x} and version {VERSION}, "
                       f"got {found:#x} and {version}")  # fmt: skip
    if not _HEAD.size + least + _CRC.size <= size <= len(block):
        raise BadBlock(f"{what}: says that it has {size} bytes, {len(block)} came")
    end = size - _CRC.size
    if zlib.crc32(memoryview(block)[:end]) != _CRC.unpack_from(block, end)[0]:
        raise BadBlock(f"{what}: its checksum is wrong")
    return block[_HEAD.size : end]


def text_of(padded: bytes) -> str:
    """Return a zero-padded ASCII text; what cannot be printed becomes a question mark."""
    return "".join(chr(c) if 0x20 <= c < 0x7F else "?" for c in padded.rstrip(b"\0"))


def member(kind: type[E], value: int, what: str) -> E:
    """Return the member of that value; raises `BadBlock`."""
    try:
        return kind(value)
    except ValueError:
        raise BadBlock(f"{what}: {value} is no {kind.__name__}") from None
