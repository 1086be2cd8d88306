"""What a recording holds: messages of outputs, pictures beside them, and facts about the graph.

A message of the output `capture.context` is on the channel `/capture/context`, in the encoding of
`pipeline.codec` with its schema. Pixels that Foxglove can show are on `/capture/context/image`
instead, and the message says so.
"""

from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pipeline import codec
from pipeline.errors import MessageError
from pipeline.messages import Frame, Message
from pipeline.recording import foxglove
from pipeline.recording.mcap_file import Item, Topic

ENCODING = "fovea"
IMAGE = "/image"
FACTS = "/fovea/"  # graph, accounts, events, end: JSON objects
_FIRST = 0  # the offset of an array that is beside the message


class Recorded(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """A message as a recording holds it."""

    stream: str
    seq: int
    beside: bool  # its pixels are in the image of the same stream and seq, just before it
    fingerprint: bytes
    body: msgspec.Raw


READ = msgspec.msgpack.Decoder(Recorded)


def topic_of(output: str) -> str:
    """Return the channel of an output, named `node.output` or `node`.

    >>> topic_of("capture.context"), topic_of("policy"), topic_of("policy.out")
    ('/capture/context', '/policy', '/policy')
    """
    return "/" + output.removesuffix(".out").replace(".", "/")


def output_of(topic: str) -> str:
    """Return the output of a channel as `node.output`.

    >>> output_of("/capture/context"), output_of("/policy")
    ('capture.context', 'policy.out')
    """
    node, _, port = topic.removeprefix("/").partition("/")
    return f"{node}.{port or 'out'}"


def items_of(output: str, message: Message, at_ns: int) -> list[Item]:
    """Return what is written for a message of an output; raises `MessageError`."""
    header, name = message.header, topic_of(output)
    picture = foxglove.raw_image(message, name) if isinstance(message, Frame) else None
    found = []
    if picture is not None:
        found.append(Item(foxglove.topic(name + IMAGE), at_ns, header.seq, picture))
    first = message.pixels if picture is not None and isinstance(message, Frame) else None

    def place(array: NDArray[Any]) -> bytes | int:
        return _FIRST if array is first else array.tobytes()

    schema = codec.schema(type(message))
    body = codec.to_bytes(schema.write(message, place))
    data = msgspec.msgpack.encode(
        Recorded(header.stream, header.seq, picture is not None, schema.fingerprint,
                 msgspec.Raw(body))
    )  # fmt: skip
    topic = Topic(
        name=name, encoding=ENCODING, schema_name=type(message).__name__, schema_encoding=ENCODING,
        schema=schema.text.encode(),
    )  # fmt: skip
    return [*found, Item(topic, at_ns, header.seq, data)]


def fact(name: str, value: Any, at_ns: int) -> Item:
    """Return a fact about the graph as a message in JSON."""
    topic = Topic(
        name=FACTS + name, encoding="json", schema_name=f"fovea.{name}",
        schema_encoding="jsonschema", schema=b'{"type": "object"}',
    )  # fmt: skip
    return Item(topic, at_ns, 0, msgspec.json.encode(value, enc_hook=str))


def message_of(cls: type[Message], record: Recorded, picture: bytes | None) -> Message:
    """Decode a message; `picture`: the image beside it. Raises `MessageError`."""
    if record.fingerprint != codec.fingerprint(cls):
        raise MessageError(f"recorded with another schema of {cls.__name__}")

    def fetch(offset: int, nbytes: int) -> NDArray[np.uint8]:
        if not record.beside or picture is None or offset != _FIRST:
            raise MessageError(f"{cls.__name__}: its picture is not in the recording")
        pixels = np.frombuffer(foxglove.pixels_of(picture), np.uint8)
        if pixels.nbytes != nbytes:
            raise MessageError(f"{cls.__name__}: expected {nbytes} bytes, got {pixels.nbytes}")
        return pixels

    try:
        found: Message = codec.unpack(cls, record.body, fetch)
    except ValueError as error:
        raise MessageError(f"{cls.__name__}: {error}") from error
    return found
