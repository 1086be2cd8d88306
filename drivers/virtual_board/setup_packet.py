"""The setup packet of a control transfer (USB 3.2, section 9.3)."""

import struct
from dataclasses import dataclass

DIRECTION_IN, VENDOR, RECIPIENT = 0x80, 0x40, 0x1F  # of `kind`
INTERFACE, ENDPOINT = 1, 2  # recipients


@dataclass(frozen=True)
class SetupPacket:
    """What the host asks for."""

    kind: int  # bmRequestType
    request: int
    value: int
    index: int
    length: int  # bytes of data that follow, or are expected

    _FIELDS = struct.Struct("<BBHHH")

    @classmethod
    def unpack(cls, data: bytes) -> "SetupPacket":
        """Return the packet of eight bytes."""
        return cls(*cls._FIELDS.unpack(data))

    @property
    def reads(self) -> bool:
        """Whether the host expects data."""
        return bool(self.kind & DIRECTION_IN)

    @property
    def vendor(self) -> bool:
        """Whether it is one of the requests of PROTOCOL.md."""
        return bool(self.kind & VENDOR)

    @property
    def recipient(self) -> int:
        """To what it is addressed."""
        return self.kind & RECIPIENT
