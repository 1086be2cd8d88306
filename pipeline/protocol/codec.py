"""The encoder and decoder of all messages that control or monitor a graph.

    marker, version | msgpack map: kind (the class's name), fields

A message of another version, an unknown kind, with an unknown field, a wrong type or too many bytes
is refused with one sentence. A `Kind` lists the messages that are valid at one point of a
conversation; the other modules of this folder define the conversations.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar, Union, get_args

import msgspec

from pipeline import codec
from pipeline.class_cache import cached_by_class
from pipeline.errors import MessageError, RunError
from pipeline.text import error_text, harmless

VERSION = 2  # incremented by every incompatible change
MARKER = 0xF5  # no JSON, text or msgpack map begins with it
MOST_BYTES = 1 << 20
TAG = "kind"
FAILED = "it failed"  # how the reason of a refusal begins for an exception of this program
LONGEST_TAG = 40  # characters of an unknown kind in an error
T = TypeVar("T")


class ControlMessage(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag=True, tag_field=TAG
):
    """Base class of all messages; encoded with the class's name."""


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of structs that are only fields of messages."""


class Refused(ControlMessage, frozen=True):
    """The reply to a request that was refused or failed; nothing was changed."""

    reason: str  # one sentence
    rolled_back: bool = False  # a change was made and undone
    busy: bool = False  # the same request may succeed a moment later


class Kind(Generic[T]):
    """The messages that are valid at one point of a conversation."""

    def __init__(self, name: str, of: Any, most_bytes: int = MOST_BYTES) -> None:
        """`name`: with its article; `of`: a class or a union of classes."""
        self.name, self.most_bytes, self._of = name, most_bytes, of
        self.classes: tuple[type[ControlMessage], ...] = get_args(of) or (of,)

    @cached_property
    def read(self) -> Callable[[Any], T]:
        """The decoder; built on first use, because a process reads few kinds."""
        return msgspec.msgpack.Decoder(self._of).decode


def encode(message: ControlMessage) -> bytes:
    """Encode a message; raises `MessageError` for values without encoding."""
    return bytes((MARKER, VERSION)) + codec.to_bytes(message)


def decode(kind: Kind[T] | type[T], data: bytes) -> T:
    """Decode untrusted bytes; raises `MessageError`.

    Errors of the message's own fields, such as the names of a plan, are raised unchanged.
    """
    wanted: Kind[T] = kind if isinstance(kind, Kind) else _kind_of(kind)
    if len(data) > wanted.most_bytes:
        raise MessageError(
            f"not {wanted.name}: expected up to {wanted.most_bytes} bytes, got {len(data)}"
        )
    if len(data) < 2 or data[0] != MARKER:
        raise MessageError(f"not {wanted.name}: expected a message, got {len(data)} other bytes")
    if data[1] != VERSION:
        raise MessageError(
            f"not {wanted.name}: expected protocol version {VERSION}, got version {data[1]}"
        )
    try:
        return codec.parse(wanted.read, data[2:], f"not {wanted.name}")
    except MessageError as error:
        if (better := _of_another_kind(wanted, data[2:])) is None:
            raise
        raise better from error


def decode_answer(kind: type[T], data: bytes, where: str = "") -> T:
    """Decode a reply of that type; raises `RunError` beginning with `where` for a `Refused`."""
    answer: T | Refused = decode(_answer_kind(kind), data)
    if isinstance(answer, Refused):
        raise RunError(f"{where}: {answer.reason}" if where else answer.reason)
    return answer


def fields_of(message: ControlMessage) -> dict[str, Any]:
    """Return the fields of a message as plain values for JSON."""
    plain: dict[str, Any] = msgspec.to_builtins(message)
    return {name: value for name, value in plain.items() if name != TAG}


def refused(reason: str, *, rolled_back: bool = False, busy: bool = False) -> Refused:
    """Return a `Refused` with a sanitised, truncated reason."""
    return Refused(harmless(reason), rolled_back, busy)


def failed(error: BaseException) -> Refused:
    """Return a `Refused` for an exception that nobody foresaw: a mistake of this program."""
    return refused(f"{FAILED}: {error_text(error)}")


@cached_by_class
def _kind_of(cls: type[Any]) -> Kind[Any]:
    return Kind(_with_article(cls), cls)


@cached_by_class
def _answer_kind(cls: type[Any]) -> Kind[Any]:
    return Kind(_with_article(cls), Union[cls, Refused])  # noqa: UP007


def _with_article(cls: type[Any]) -> str:
    return f"{'an' if cls.__name__[0] in 'AEIOU' else 'a'} {cls.__name__}"


def _of_another_kind(wanted: Kind[Any], body: bytes) -> MessageError | None:
    """Return an error for a valid message of an unexpected kind."""
    try:
        found = msgspec.msgpack.decode(body)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None
    tag = found.get(TAG) if isinstance(found, dict) else None
    known = [cls.__name__ for cls in wanted.classes]
    if not isinstance(tag, str) or tag in known:
        return None
    return MessageError(
        f"not {wanted.name}: expected {' or '.join(known)}, got {harmless(tag, LONGEST_TAG)}"
    )
