"""Dataclasses to bytes and back, without pickle: dataclass -> msgpack body + arrays -> dataclass.

A schema is read once from the type annotations. Its fingerprint travels with every message, so two
sides that disagree notice before anything is decoded. Decoding trusts nothing: every type, size and
shape is checked, and any violation is a `MessageError`.

msgspec writes and reads everything but arrays in one call; a dataclass that holds arrays has a twin
for it, in which each array is its dtype, its sides and its bytes or offset.
"""

import dataclasses
import hashlib
import math
import types
import typing
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import msgspec
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError
from pipeline.messages import Shape
from pipeline.once import once

T = TypeVar("T")
Place = Callable[[NDArray[Any]], bytes | int]  # puts an array somewhere: the bytes, or an offset
Buffer = bytes | msgspec.Raw
Fetch = Callable[[int, int], NDArray[np.uint8]]  # offset, nbytes -> (nbytes,) uint8
Side = Annotated[int, msgspec.Meta(ge=0)]

_DTYPES = {np.dtype(t).str: np.dtype(t) for t in ("?", "u1", "u2", "i4", "i8", "f4", "f8", "u8")}
_SCALARS = (bool, int, float, str, bytes)


class Schema:
    """The fields of a dataclass, how each is written, and how all are read."""

    def __init__(self, cls: type[Any]) -> None:
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
        self.decode = msgspec.msgpack.Decoder(self.wire).decode
        self.checked = hasattr(cls, "__post_init__") or not hasattr(cls, "__dict__")

    @property
    def fingerprint(self) -> bytes:
        """Eight bytes that change whenever a name, a type or a shape changes."""
        return hashlib.sha256(self.text.encode()).digest()[:8]


@once
def schema(cls: type[Any]) -> Schema:
    """The schema of a dataclass; raises `MessageError` for a field that cannot travel."""
    return Schema(cls)


@once
def fingerprint(cls: type[Any]) -> bytes:
    """The fingerprint of a dataclass's schema, eight bytes."""
    return schema(cls).fingerprint


def pack(value: Any, place: Place | None = None) -> Any:
    """What `to_bytes` takes for a dataclass; `place` decides where each array goes."""
    return _written(schema(type(value)), value, place or _inline)


def unpack(cls: type[T], data: Buffer, fetch: Fetch | None = None) -> T:
    """The dataclass behind the bytes of a `pack`; arrays are views of what `fetch` gives."""
    plan = schema(cls)
    return _read(plan, cls, parse(plan.decode, data, cls.__name__), fetch or _nowhere)


def dumps(value: Any) -> bytes:
    """A dataclass with all its arrays as one byte string, fingerprint first."""
    return fingerprint(type(value)) + to_bytes(pack(value))


def loads(cls: type[T], data: bytes) -> T:
    """What `dumps` wrote; raises `MessageError` when it is anything else."""
    if data[:8] != fingerprint(cls):
        raise MessageError(f"{cls.__name__}: fingerprint {data[:8].hex()} is of another schema")
    return unpack(cls, data[8:])


def to_bytes(body: Any) -> bytes:
    """msgpack, nothing else; raises `MessageError` for what cannot travel."""
    try:
        return _encode(body)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise MessageError(f"cannot travel: {error}") from error


def parse(decode: Callable[[Buffer], T], data: Buffer, what: str) -> T:
    """What a msgspec decoder makes of untrusted bytes; raises `MessageError` beginning `what`."""
    try:
        return decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise MessageError(f"{what}: {error}") from error


class _Kind(ABC):
    """How one field is written and read."""

    plain = False  # msgspec writes and reads it as it is

    def __init__(self, text: str, wire: Any) -> None:
        self.text, self.wire = text, wire

    @abstractmethod
    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any: ...

    @abstractmethod
    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any: ...


class _Plain(_Kind):
    """Numbers, texts, and tuples and dataclasses of them."""

    plain = True

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        return value

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        return item


class _Tuple(_Kind):
    """A tuple with arrays somewhere inside."""

    def __init__(self, text: str, wire: Any, items: tuple[_Kind, ...], *, endless: bool) -> None:
        super().__init__(text, wire)
        self.items, self.endless = items, endless

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        pairs = zip(self._kinds(value), value, strict=True)
        return tuple(kind.pack(item, place, known, where) for kind, item in pairs)

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        pairs = zip(self._kinds(item), item, strict=True)
        return tuple(kind.unpack(part, fetch, known, where) for kind, part in pairs)

    def _kinds(self, value: tuple[Any, ...]) -> tuple[_Kind, ...]:
        return self.items * len(value) if self.endless else self.items


class _Nested(_Kind):
    """A dataclass with arrays somewhere inside."""

    def __init__(self, cls: type[Any]) -> None:
        super().__init__(schema(cls).text, schema(cls).wire)
        self.cls = cls

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        return _written(schema(self.cls), value, place)

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        return _read(schema(self.cls), self.cls, item, fetch)


class _Spot(msgspec.Struct, array_like=True, forbid_unknown_fields=True, gc=False):
    """An array on the wire."""

    dtype: str
    sides: tuple[Side, ...]
    spot: bytes | Side  # its bytes, or where they begin in the pool's slot


class _Array(_Kind):
    def __init__(self, dtypes: frozenset[str], shape: Shape | None) -> None:
        super().__init__(f"array[{'|'.join(sorted(dtypes))}]{shape or ''}", _Spot)
        self.dtypes, self.shape = dtypes, shape

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        if not isinstance(value, np.ndarray) or value.dtype.str not in self.dtypes:
            got = value.dtype.str if isinstance(value, np.ndarray) else type(value).__name__
            raise MessageError(f"{where}: expected {self.text}, got {got}")
        if self.shape:
            self.shape.check(where, value.shape, known)
        return (value.dtype.str, value.shape, place(value))

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        if item.dtype not in self.dtypes:
            raise MessageError(f"{where}: expected {self.text}, got another kind of array")
        dtype, sides, spot = _DTYPES[item.dtype], item.sides, item.spot
        nbytes = dtype.itemsize * math.prod(sides)
        if type(spot) is bytes:
            raw = np.frombuffer(spot, np.uint8)
        elif spot % dtype.itemsize == 0:
            raw = fetch(spot, nbytes)
        else:
            raise MessageError(f"{where}: expected an offset of whole items, got {spot}")
        if raw.nbytes != nbytes:
            raise MessageError(f"{where}: expected {nbytes} bytes for {sides}, got {raw.nbytes}")
        if self.shape:
            self.shape.check(where, sides, known)
        array: NDArray[Any] = np.ndarray(sides, dtype, raw)
        return array


def _written(plan: Schema, value: Any, place: Place) -> Any:
    if not plan.converted:
        return value
    known: dict[str, int] = {}
    items = [getattr(value, name) for name in plan.names]
    for index, _name, kind, where in plan.converted:
        items[index] = kind.pack(items[index], place, known, where)
    return items


def _read(plan: Schema, cls: type[T], wire: Any, fetch: Fetch) -> T:
    if not plan.converted:
        return wire  # type: ignore[no-any-return]
    values = msgspec.structs.asdict(wire)
    known: dict[str, int] = {}
    for _index, name, kind, where in plan.converted:
        values[name] = kind.unpack(values[name], fetch, known, where)
    if not plan.checked:  # as its __init__ would, in a fraction of the time
        fresh = object.__new__(cls)
        fresh.__dict__.update(values)
        return fresh
    try:
        return cls(**values)
    except (TypeError, ValueError) as error:
        raise MessageError(f"{cls.__name__}: {error}") from error


def _kind(hint: Any, where: str) -> _Kind:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        shape = next((a for a in arguments[1:] if isinstance(a, Shape)), None)
        return _Array(_dtypes(arguments[0], where), shape)
    if origin is np.ndarray or origin in (Union, types.UnionType):
        return _Array(_dtypes(hint, where), None)
    if origin is tuple:
        return _tuple(arguments, where)
    if isinstance(hint, type) and hint in _SCALARS:
        return _Plain(hint.__name__, hint)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        plan = schema(hint)
        return _Nested(hint) if plan.converted else _Plain(plan.text, hint)
    raise MessageError(f"{where}: a field of type {hint} cannot travel")


def _tuple(arguments: tuple[Any, ...], where: str) -> _Kind:
    endless = len(arguments) == 2 and arguments[1] is Ellipsis
    items = tuple(_kind(a, where) for a in (arguments[:1] if endless else arguments))
    size = "*" if endless else str(len(items))
    text = f"tuple{size}[{','.join(k.text for k in items)}]"
    wires = tuple(kind.wire for kind in items)
    wire = types.GenericAlias(tuple, (*wires, ...) if endless else wires)
    if all(kind.plain for kind in items):
        return _Plain(text, wire)
    return _Tuple(text, wire, items, endless=endless)


def _twin(cls: type[Any], kinds: Mapping[str, _Kind]) -> type[Any]:
    """The struct that travels in the place of a dataclass with arrays."""
    fields = [(name, kind.wire) for name, kind in kinds.items()]
    return msgspec.defstruct(cls.__name__, fields, array_like=True, forbid_unknown_fields=True)


def _dtypes(hint: Any, where: str) -> frozenset[str]:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return frozenset().union(*(_dtypes(a, where) for a in arguments))
    scalar = get_args(arguments[1])[0] if origin is np.ndarray else None
    if not isinstance(scalar, type) or np.dtype(scalar).str not in _DTYPES:
        raise MessageError(f"{where}: expected an array of {sorted(_DTYPES)}, got {hint}")
    return frozenset({np.dtype(scalar).str})


def _fields(cls: type[Any]) -> tuple[dataclasses.Field[Any], ...]:
    if not dataclasses.is_dataclass(cls):
        raise MessageError(f"{cls.__name__}: expected a dataclass")
    return dataclasses.fields(cls)


def _inline(array: NDArray[Any]) -> bytes:
    return array.tobytes()


def _nowhere(_offset: int, _nbytes: int) -> NDArray[np.uint8]:
    raise MessageError("an array lies in a frame pool that was not named")


def _bare(value: Any) -> Any:
    """numpy's numbers travel as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    raise MessageError(f"cannot travel: a {type(value).__name__}")


_encode = msgspec.msgpack.Encoder(enc_hook=_bare).encode
