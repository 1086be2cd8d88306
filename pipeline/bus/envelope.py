"""What surrounds a message on the bus: untrusted bytes -> numbers, fingerprint, slot, body."""

from typing import Annotated, Any, Literal

import msgspec

from pipeline import codec
from pipeline.bus.pool import SlotRef

VERSION = 2  # also below, where a type checker wants the number itself
Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 62)]
HANDSHAKE, MESSAGE, NOTHING = 0, 1, 2
# bodies of handshakes: of an instance that took over without a loss, and of one after a loss
GOES_ON, LOST = msgspec.msgpack.encode(True), msgspec.msgpack.encode(False)

EPOCH_BITS = 32


def first_of(epoch: int) -> int:
    """The first number of an instance whose output has no reader, and so no account to go on from.

    Numbers of one output thus only grow, also where no predecessor's are known.
    """
    return (epoch << EPOCH_BITS) + 1


class Envelope(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """What surrounds a message on the bus."""

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
        """The envelope of what `codec.pack` gave; raises `MessageError` for what cannot travel."""
        return codec.to_bytes((VERSION, kind, ordinal, epoch, fingerprint, slot, body))

    @staticmethod
    def parse(payload: bytes) -> "Envelope":
        """Read an envelope from untrusted bytes; raises `MessageError`."""
        return codec.parse(_read_envelope, payload, "not an envelope of this version")


_read_envelope = msgspec.msgpack.Decoder(Envelope).decode
