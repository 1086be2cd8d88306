"""Dataclasses to bytes and back, without pickle: dataclass -> msgpack body + arrays -> dataclass.

A schema is derived once from the type annotations. Its fingerprint travels with every message, so
that a mismatch between sender and receiver is found before anything is decoded. The decoder trusts
nothing: it checks every type, size and shape, and raises `MessageError` for any violation.

msgspec encodes and decodes everything but arrays in one call. A dataclass with arrays has a
matching msgspec struct, in which an array is its dtype, its shape and its bytes or offset.
"""

import dataclasses
import hashlib
import types
import typing
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Generic, TypeVar, Union, cast, get_args, get_origin

import msgspec
import numpy as np
from numpy.typing import NDArray

from pipeline.class_cache import cached_by_class
from pipeline.errors import MessageError
from pipeline.fields import DTYPES, Array, Fetch, Kind, Nested, PlaceArray, Plain, Tuples
from pipeline.messages import Message, Shape
from pipeline.text import harmless

T = TypeVar("T")
Buffer = bytes | msgspec.Raw

LONGEST_REASON = 300  # characters: it may quote received data
_SCALARS = (bool, int, float, str, bytes)
_AS_THEY_ARE = (bytes,)  # natively, not as base64 text


class Schema(Generic[T]):
    """Encoder and decoder of one dataclass, derived from its fields."""

    def __init__(self, cls: type[T]) -> None:
        self.cls = cls
        hints = typing.get_type_hints(cls, include_extras=True)
        self.names = tuple(f.name for f in _fields(cls))
        kinds = {name: _kind(hints[name], f"{cls.__name__}.{name}") for name in self.names}
        self.text = f"{cls.__name__}({','.join(f'{n}:{k.text}' for n, k in kinds.items())})"
        self.converted = tuple(
            (index, name, kinds[name], f"{cls.__name__}.{name}")
            for index, name in enumerate(self.names)
            if not kinds[name].plain
        )
        self.wire: type[Any] = cls if not self.converted else _twin(cls, kinds)
        self._decode = msgspec.msgpack.Decoder(self.wire).decode
        trusted = {"header"} if issubclass(cls, Message) else set()  # the runtime writes it
        self._plain = {n: k for n, k in kinds.items() if k.plain and n not in trusted}
        # a fast type check; it does not descend into dataclasses
        deep = any(_holds_dataclass(hints[name]) for name in self._plain)
        self._quick = None if deep else _twin(cls, self._plain)
        flat = all(isinstance(kind, Array) for _, _, kind, _ in self.converted)
        self._flat = flat and not deep and bool(self.converted)
        if flat and len(self.converted) == 1:
            cast(Array, self.converted[0][2]).alone = True
        self._checked = hasattr(cls, "__post_init__") or not hasattr(cls, "__dict__")

    @property
    def fingerprint(self) -> bytes:
        """Eight bytes that change whenever a name, a type or a shape changes."""
        return hashlib.sha256(self.text.encode()).digest()[:8]

    def write(self, value: T, place: PlaceArray) -> Any:
        """Return the object that msgspec encodes for a value.

        Raises `MessageError` for a field of the wrong type, as the decoder would; only the header
        of a message, which the runtime writes, is trusted.
        """
        if self._plain and self._look(value) is None:
            self._check(value)  # accepts numpy scalars, and names the field in its error
        if not self.converted:
            return value
        known: dict[str, int] = {}
        items = [getattr(value, name) for name in self.names]
        for index, _name, kind, where in self.converted:
            items[index] = kind.pack(items[index], place, known, where)
        return items

    def carried(self, value: T) -> T:
        """Return the value as a reader in another process gets it, with read-only array views.

        Raises `MessageError` for a value that cannot be encoded.
        """
        plain = self._look(value) if self._flat and not self._checked else None
        if plain is None:
            return self._sent(value)
        to_bytes(plain)  # only this finds integers that are too large
        known: dict[str, int] = {}
        values = {**vars(value), **msgspec.structs.asdict(plain)}
        for _index, name, kind, where in self.converted:
            assert isinstance(kind, Array)
            values[name] = kind.carried(values[name], known, where)
        fresh = object.__new__(self.cls)
        fresh.__dict__.update(values)
        return fresh

    def _sent(self, value: T) -> T:
        """Encode and decode the value; the arrays themselves are not copied."""
        arrays: list[NDArray[Any]] = []

        def place(array: NDArray[Any]) -> int:
            arrays.append(np.ascontiguousarray(array))
            return 8 * (len(arrays) - 1)  # a multiple of every item size

        def fetch(offset: int, _nbytes: int) -> NDArray[np.uint8]:
            raw = arrays[offset // 8].reshape(-1).view(np.uint8)
            raw.flags.writeable = False
            return raw

        return self.read(to_bytes(self.write(value, place)), fetch)

    def _look(self, value: T) -> Any:
        """Return the plain fields as a reader gets them; None when a full check is needed."""
        if self._quick is None:
            return None
        plain = [getattr(value, name) for name in self._plain]
        try:
            return msgspec.convert(plain, self._quick, builtin_types=_AS_THEY_ARE)
        except msgspec.ValidationError:
            return None

    def _check(self, value: T) -> None:
        """Raise `MessageError` for a plain field that the decoder would refuse."""
        for name, kind in self._plain.items():
            item = getattr(value, name)
            try:
                msgspec.msgpack.decode(_encode(item), type=kind.wire)
            except (msgspec.MsgspecError, MessageError, TypeError, ValueError, OverflowError):
                where = f"{self.cls.__name__}.{name}"
                raise MessageError(f"{where}: expected {kind.text}, got {_brief(item)}") from None

    def read(self, data: Buffer, fetch: Fetch) -> T:
        """Decode untrusted bytes; raises `MessageError`."""
        return self.build(parse(self._decode, data, self.cls.__name__), fetch)

    def build(self, wire: Any, fetch: Fetch) -> T:
        """Return the value for the object that msgspec decoded."""
        if not self.converted:
            return wire  # type: ignore[no-any-return]
        values = msgspec.structs.asdict(wire)
        known: dict[str, int] = {}
        for _index, name, kind, where in self.converted:
            values[name] = kind.unpack(values[name], fetch, known, where)
        if not self._checked:  # does what __init__ would, in a fraction of the time
            fresh = object.__new__(self.cls)
            fresh.__dict__.update(values)
            return fresh
        try:
            return self.cls(**values)
        except (TypeError, ValueError) as error:
            raise MessageError(f"{self.cls.__name__}: {error}") from error


@cached_by_class
def schema(cls: type[Any]) -> Schema[Any]:
    """Return the schema of a dataclass; raises `MessageError` for a field type without encoding."""
    return Schema(cls)


@cached_by_class
def fingerprint(cls: type[Any]) -> bytes:
    """The fingerprint of a dataclass's schema, eight bytes."""
    return schema(cls).fingerprint


def pack(value: Any, place: PlaceArray | None = None) -> Any:
    """Return a dataclass as the object that `to_bytes` takes; `place` stores each array."""
    return schema(type(value)).write(value, place or _inline)


def unpack(cls: type[T], data: Buffer, fetch: Fetch | None = None) -> T:
    """Decode the bytes of a `pack` to a dataclass; arrays are views of what `fetch` returns."""
    value: T = schema(cls).read(data, fetch or nowhere)
    return value


def carried(value: T) -> T:
    """Return the dataclass as a reader in another process would get it, without sending it.

    >>> from pipeline import Frame
    >>> from pipeline.testing import header, picture
    >>> frame = carried(Frame(header=header(), pixels=picture(2, 2, seed=1)))
    >>> frame.pixels.flags.writeable
    False
    """
    own: Schema[T] = schema(type(value))
    return own.carried(value)


def dumps(value: Any) -> bytes:
    """Encode a dataclass with all its arrays as one byte string, fingerprint first."""
    return fingerprint(type(value)) + to_bytes(pack(value))


def loads(cls: type[T], data: bytes) -> T:
    """Decode the output of `dumps`; raises `MessageError` for anything else."""
    if data[:8] != fingerprint(cls):
        raise MessageError(f"{cls.__name__}: fingerprint {data[:8].hex()} is of another schema")
    return unpack(cls, data[8:])


def to_bytes(body: Any) -> bytes:
    """Encode as msgpack; raises `MessageError` for a value without encoding."""
    try:
        return _encode(body)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise MessageError(f"cannot travel: {error}") from error


def parse(decode: Callable[[Buffer], T], data: Buffer, what: str) -> T:
    """Decode untrusted bytes with msgspec; raises `MessageError` beginning with `what`."""
    try:
        return decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        # msgspec 0.23 has words and a class of its own for it
        is_text = isinstance(error, UnicodeError) or "UTF-8" in str(error)
        why = "expected text in UTF-8, got other bytes" if is_text else str(error)
        raise MessageError(f"{what}: {harmless(why, LONGEST_REASON)}") from error


def _kind(hint: Any, where: str) -> Kind:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        shape = next((a for a in arguments[1:] if isinstance(a, Shape)), None)
        return Array(_dtypes(arguments[0], where), shape)
    if origin is np.ndarray or origin in (Union, types.UnionType):
        return Array(_dtypes(hint, where), None)
    if origin is tuple:
        return _tuple(arguments, where)
    if isinstance(hint, type) and hint in _SCALARS:
        return Plain(hint.__name__, hint)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        plan = schema(hint)
        return Nested(plan) if plan.converted else Plain(plan.text, hint)
    raise MessageError(f"{where}: a field of type {hint} cannot travel")


def _tuple(arguments: tuple[Any, ...], where: str) -> Kind:
    endless = len(arguments) == 2 and arguments[1] is Ellipsis
    items = tuple(_kind(a, where) for a in (arguments[:1] if endless else arguments))
    size = "*" if endless else str(len(items))
    text = f"tuple{size}[{','.join(k.text for k in items)}]"
    wires = tuple(kind.wire for kind in items)
    wire = types.GenericAlias(tuple, (*wires, ...) if endless else wires)
    if all(kind.plain for kind in items):
        return Plain(text, wire)
    return Tuples(text, wire, items, endless=endless)


def _twin(cls: type[Any], kinds: Mapping[str, Kind]) -> type[Any]:
    """Return the msgspec struct that is sent for a dataclass with arrays."""
    fields = [(name, kind.wire) for name, kind in kinds.items()]
    return msgspec.defstruct(cls.__name__, fields, array_like=True, forbid_unknown_fields=True)


def _dtypes(hint: Any, where: str) -> frozenset[str]:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return frozenset().union(*(_dtypes(a, where) for a in arguments))
    scalar = get_args(arguments[1])[0] if origin is np.ndarray else None
    if not isinstance(scalar, type) or np.dtype(scalar).str not in DTYPES:
        raise MessageError(f"{where}: expected an array of {sorted(DTYPES)}, got {hint}")
    return frozenset({np.dtype(scalar).str})


def _fields(cls: type[Any]) -> tuple[dataclasses.Field[Any], ...]:
    if not dataclasses.is_dataclass(cls):
        raise MessageError(f"{cls.__name__}: expected a dataclass")
    return dataclasses.fields(cls)


def _holds_dataclass(hint: Any) -> bool:
    if get_origin(hint) is tuple:
        return any(map(_holds_dataclass, get_args(hint)))
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)


def _brief(value: Any) -> str:
    """Describe a value in a few words.

    >>> _brief("x" * 100), _brief(np.zeros(3, np.float32))
    ("a str 'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx…", 'a float32 array of (3,)')
    """
    if isinstance(value, np.ndarray):
        return f"a {value.dtype} array of {value.shape}"
    if value is None:
        return "None"
    shown = repr(value)
    name = type(value).__name__
    article = "an" if name[0] in "aeiou" else "a"
    return f"{article} {name} {shown if len(shown) <= 40 else shown[:39] + '…'}"


def _inline(array: NDArray[Any]) -> bytes:
    return array.tobytes()


def nowhere(_offset: int, _nbytes: int) -> NDArray[np.uint8]:
    """The `Fetch` for a message with its arrays inline."""
    raise MessageError("an array lies in a frame pool that was not named")


def _bare(value: Any) -> Any:
    """Convert numpy scalars to Python numbers."""
    if isinstance(value, np.generic):
        return value.item()
    raise MessageError(f"cannot travel: a {type(value).__name__}")


_encode = msgspec.msgpack.Encoder(enc_hook=_bare).encode
