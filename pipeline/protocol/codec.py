"""The one encoder and the one decoder of everything that is said to steer or to watch a graph.

    marker, version | msgpack map: kind (the class's name), fields

A message of another version, of an unknown kind, with an unknown field, of a wrong type or with too
many bytes is refused in one sentence. Which messages belong to a conversation is said by a `Kind`;
the conversations are the other modules of this folder.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar, Union, get_args

import msgspec

from pipeline import codec
from pipeline.class_cache import cached_by_class
from pipeline.errors import MessageError, RunError
from pipeline.text import harmless

VERSION = 1  # rises with every change that another version would not understand
MARKER = 0xF5  # begins no JSON, no text and no msgpack map
MOST_BYTES = 1 << 20
TAG = "kind"
LONGEST_TAG = 40  # characters of an unknown kind that are repeated
T = TypeVar("T")


class ControlMessage(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag=True, tag_field=TAG
):
    """Base of all messages; the class's name travels with the fields."""


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of what is only ever a field of a message."""


class Refused(ControlMessage, frozen=True):
    """The answer to what was not done; nothing was changed, or it was changed back."""

    reason: str  # one sentence
    rolled_back: bool = False  # it was tried, and taken back


class Kind(Generic[T]):
    """The messages that may come at one place of a conversation."""

    def __init__(self, name: str, of: Any, most_bytes: int = MOST_BYTES) -> None:
        """`name` with its article; `of`: a class, or a union of classes."""
        self.name, self.most_bytes, self._of = name, most_bytes, of
        self.classes: tuple[type[ControlMessage], ...] = get_args(of) or (of,)

    @cached_property
    def read(self) -> Callable[[Any], T]:
        """What decodes them; made when it is needed, for a process reads few kinds."""
        return msgspec.msgpack.Decoder(self._of).decode


def encode(message: ControlMessage) -> bytes:
    """The bytes of a message; raises `MessageError` for values that cannot travel."""
    return bytes((MARKER, VERSION)) + codec.to_bytes(message)


def decode(kind: Kind[T] | type[T], data: bytes) -> T:
    """The message behind untrusted bytes; raises `MessageError`.

    What the message's own fields refuse, such as a plan's names, is raised as it is.
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
    """An answer of that kind; raises `RunError`, beginning with `where`, when it is a refusal."""
    answer: T | Refused = decode(_answer_kind(kind), data)
    if isinstance(answer, Refused):
        raise RunError(f"{where}: {answer.reason}" if where else answer.reason)
    return answer


def fields_of(message: ControlMessage) -> dict[str, Any]:
    """The fields of a message as plain values, for a file or for a script that reads JSON."""
    plain: dict[str, Any] = msgspec.to_builtins(message)
    return {name: value for name, value in plain.items() if name != TAG}


def refused(reason: str, *, rolled_back: bool = False) -> Refused:
    """A refusal in printable characters, cut to a length."""
    return Refused(harmless(reason), rolled_back)


@cached_by_class
def _kind_of(cls: type[Any]) -> Kind[Any]:
    return Kind(_with_article(cls), cls)


@cached_by_class
def _answer_kind(cls: type[Any]) -> Kind[Any]:
    return Kind(_with_article(cls), Union[cls, Refused])  # noqa: UP007


def _with_article(cls: type[Any]) -> str:
    return f"{'an' if cls.__name__[0] in 'AEIOU' else 'a'} {cls.__name__}"


def _of_another_kind(wanted: Kind[Any], body: bytes) -> MessageError | None:
    """What to say of a message whose kind does not belong here."""
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
