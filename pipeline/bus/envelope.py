"""Envelope of a message on the bus: untrusted bytes -> numbers, fingerprint, slot, body."""

from typing import Annotated, Any, Literal

import msgspec

from pipeline import codec
from pipeline.bus.pool import SlotRef

VERSION = 2  # repeated below, where a type checker needs the literal
Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 62)]
HANDSHAKE, MESSAGE, NOTHING = 0, 1, 2
# bodies of handshakes: from an instance that took over without a loss, and from one after a loss
GOES_ON, LOST = msgspec.msgpack.encode(True), msgspec.msgpack.encode(False)

EPOCH_BITS = 32


def first_of(epoch: int) -> int:
    """Return the first ordinal of an instance whose output has no reader, hence no account.

    Ordinals of one output thus always increase, even if the predecessor's are unknown.
    """
    return (epoch << EPOCH_BITS) + 1


class Envelope(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """The envelope of a message on the bus."""

    version: Literal[2]
    kind: Literal[0, 1, 2]
    ordinal: Count
    epoch: Count
    fingerprint: bytes
    slot: SlotRef | None
    body: msgspec.Raw

    @staticmethod
    def render(
        kind: int, ordinal: int, epoch: int, fingerprint: bytes, slot: SlotRef | None, body: Any
    ) -> bytes:
        """Encode an output of `codec.pack` with its envelope; raises `MessageError`."""
        return codec.to_bytes((VERSION, kind, ordinal, epoch, fingerprint, slot, body))

    @staticmethod
    def parse(payload: bytes) -> "Envelope":
        """Decode an envelope from untrusted bytes; raises `MessageError`."""
        return codec.parse(_read_envelope, payload, "not an envelope of this version")


_read_envelope = msgspec.msgpack.Decoder(Envelope).decode
