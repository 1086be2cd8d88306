"""Dataclasses to bytes and back, without pickle: dataclass -> msgpack body + arrays -> dataclass.

A schema is read once from the type annotations. Its fingerprint travels with every message, so two
sides that disagree notice before anything is decoded. Decoding trusts nothing: every type, size and
shape is checked, and any violation is a `MessageError`.
"""

import dataclasses
import hashlib
import operator
import types
import typing
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import msgpack
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError
from pipeline.messages import Shape
from pipeline.once import once

T = TypeVar("T")
Place = Callable[[NDArray[Any]], bytes | int]  # puts an array somewhere: the bytes, or an offset
Fetch = Callable[[int, int], NDArray[np.uint8]]  # offset, nbytes -> (nbytes,) uint8

_DTYPES = {np.dtype(t).str: np.dtype(t) for t in ("?", "u1", "u2", "i4", "i8", "f4", "f8", "u8")}
_SCALARS: dict[type, tuple[type, ...]] = {
    bool: (bool,),
    int: (int,),
    float: (float, int),
    str: (str,),
    bytes: (bytes,),
}


@dataclasses.dataclass(frozen=True)
class Schema:
    """How one dataclass is written: field names in order, and a codec for each."""

    cls: type[Any]
    fields: tuple[tuple[str, "_Kind"], ...]
    readers: tuple[tuple[str, "_Kind", str], ...]  # with the field's full name for complaints
    text: str

    @property
    def fingerprint(self) -> bytes:
        """Eight bytes that change whenever a name, a type or a shape changes."""
        return hashlib.sha256(self.text.encode()).digest()[:8]


@once
def schema(cls: type[Any]) -> Schema:
    """The schema of a dataclass; raises `MessageError` for a field that cannot travel."""
    hints = typing.get_type_hints(cls, include_extras=True)
    fields = tuple((f.name, _kind(hints[f.name], f"{cls.__name__}.{f.name}")) for f in _fields(cls))
    readers = tuple((name, kind, f"{cls.__name__}.{name}") for name, kind in fields)
    return Schema(
        cls, fields, readers, f"{cls.__name__}({','.join(f'{n}:{k.text}' for n, k in fields)})"
    )


@once
def fingerprint(cls: type[Any]) -> bytes:
    """The fingerprint of a dataclass's schema, eight bytes."""
    return schema(cls).fingerprint


def pack(value: Any, place: Place | None = None) -> list[Any]:
    """A dataclass as nested lists for msgpack; `place` decides where each array goes."""
    plan = schema(type(value))
    known: dict[str, int] = {}
    return [
        kind.pack(getattr(value, name), place or _inline, known, name) for name, kind in plan.fields
    ]


def unpack(cls: type[T], body: Any, fetch: Fetch | None = None) -> T:
    """The dataclass that `pack` wrote; arrays are read-only views of what `fetch` gives."""
    plan = schema(cls)
    if not isinstance(body, list) or len(body) != len(plan.fields):
        raise MessageError(f"{cls.__name__}: expected {len(plan.fields)} fields, got {_say(body)}")
    known: dict[str, int] = {}
    fetch = fetch or _nowhere
    values = {
        name: kind.unpack(item, fetch, known, where)
        for (name, kind, where), item in zip(plan.readers, body)  # noqa: B905 - checked above
    }
    try:
        return cls(**values)
    except (TypeError, ValueError) as error:
        raise MessageError(f"{cls.__name__}: {error}") from error


def dumps(value: Any) -> bytes:
    """A dataclass with all its arrays as one byte string, fingerprint first."""
    return fingerprint(type(value)) + to_bytes(pack(value))


def loads(cls: type[T], data: bytes) -> T:
    """What `dumps` wrote; raises `MessageError` when it is anything else."""
    if data[:8] != fingerprint(cls):
        raise MessageError(f"{cls.__name__}: fingerprint {data[:8].hex()} is of another schema")
    return unpack(cls, from_bytes(data[8:]))


def to_bytes(body: Any) -> bytes:
    """msgpack, nothing else."""
    return writer()(body)


def writer() -> Callable[[Any], bytes]:
    """`to_bytes` for one thread that writes again and again: it keeps its buffer."""
    pack_one: Callable[[Any], bytes] = msgpack.Packer(use_bin_type=True, buf_size=1 << 14).pack
    return pack_one


def from_bytes(data: bytes) -> Any:
    """msgpack with limits; raises `MessageError` for anything malformed."""
    try:
        return msgpack.unpackb(
            data, raw=False, strict_map_key=True, use_list=True, max_ext_len=0, max_map_len=0
        )
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as error:
        raise MessageError(f"not a message: {type(error).__name__}: {error}") from error


class _Kind(ABC):
    """How one field is written and read."""

    def __init__(self, text: str) -> None:
        self.text = text

    @abstractmethod
    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any: ...

    @abstractmethod
    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any: ...


class _Scalar(_Kind):
    def __init__(self, cls: type) -> None:
        super().__init__(cls.__name__)
        self.cls, self.allowed = cls, _SCALARS[cls]

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        return value.item() if isinstance(value, np.generic) else value

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        if type(item) not in self.allowed:
            raise MessageError(f"{where}: expected {self.text}, got {_say(item)}")
        return self.cls(item)


class _Tuple(_Kind):
    def __init__(self, items: tuple[_Kind, ...], length: int | None) -> None:
        size = "*" if length is None else str(length)
        super().__init__(f"tuple{size}[{','.join(k.text for k in items)}]")
        self.items, self.length = items, length

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        kinds = self.items * len(value) if self.length is None else self.items
        pairs = zip(kinds, value, strict=True)
        return [kind.pack(item, place, known, where) for kind, item in pairs]

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        if not isinstance(item, list) or self.length not in (None, len(item)):
            raise MessageError(f"{where}: expected {self.text}, got {_say(item)}")
        kinds = self.items * len(item) if self.length is None else self.items
        return tuple(
            kind.unpack(part, fetch, known, where) for kind, part in zip(kinds, item, strict=True)
        )


class _Nested(_Kind):
    def __init__(self, cls: type[Any]) -> None:
        super().__init__(schema(cls).text)
        self.cls = cls

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        return pack(value, place)

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        return unpack(self.cls, item, fetch)


class _Flat(_Nested):
    """A dataclass of scalars only: the many small ones in every header, so it is written fast."""

    def __init__(self, cls: type[Any]) -> None:
        super().__init__(cls)
        self.names = tuple(f.name for f in _fields(cls))
        self.values = operator.attrgetter(*self.names)
        kinds = dict(schema(cls).fields)
        self.types = [kinds[name].cls for name in self.names]  # type: ignore[attr-defined]

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        return self.values(value)

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        if not isinstance(item, list) or [type(part) for part in item] != self.types:
            return super().unpack(item, fetch, known, where)
        fresh = object.__new__(self.cls)
        fresh.__dict__.update(zip(self.names, item, strict=True))
        return fresh


class _Array(_Kind):
    """Written as [dtype, sides, bytes or offset]."""

    def __init__(self, dtypes: frozenset[str], shape: Shape | None) -> None:
        super().__init__(f"array[{'|'.join(sorted(dtypes))}]{shape or ''}")
        self.dtypes, self.shape = dtypes, shape

    def pack(self, value: Any, place: Place, known: dict[str, int], where: str) -> Any:
        if not isinstance(value, np.ndarray) or value.dtype.str not in self.dtypes:
            got = value.dtype.str if isinstance(value, np.ndarray) else type(value).__name__
            raise MessageError(f"{where}: expected {self.text}, got {got}")
        if self.shape:
            self.shape.check(where, value.shape, known)
        return [value.dtype.str, value.shape, place(value)]

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        named = isinstance(item, list) and len(item) == 3 and isinstance(item[0], str)
        if not named or item[0] not in self.dtypes:
            raise MessageError(f"{where}: expected {self.text}, got {_say(item)}")
        dtype, sides, spot = _DTYPES[item[0]], item[1], item[2]
        if not isinstance(sides, list) or not all(type(s) is int and s >= 0 for s in sides):
            raise MessageError(f"{where}: expected sides of an array, got {_say(sides)}")
        nbytes = dtype.itemsize
        for side in sides:
            nbytes *= side
        if isinstance(spot, bytes):
            raw = np.frombuffer(spot, np.uint8)
        elif type(spot) is int and spot >= 0 and spot % dtype.itemsize == 0:
            raw = fetch(spot, nbytes)
        else:
            raise MessageError(f"{where}: expected bytes or an offset, got {_say(spot)}")
        if raw.nbytes != nbytes:
            raise MessageError(f"{where}: expected {nbytes} bytes for {sides}, got {raw.nbytes}")
        if self.shape:
            self.shape.check(where, tuple(sides), known)
        return raw.view(dtype).reshape(sides)


def _kind(hint: Any, where: str) -> _Kind:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        shape = next((a for a in arguments[1:] if isinstance(a, Shape)), None)
        return _Array(_dtypes(arguments[0], where), shape)
    if origin is np.ndarray or origin in (Union, types.UnionType):
        return _Array(_dtypes(hint, where), None)
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return _Tuple((_kind(arguments[0], where),), None)
        return _Tuple(tuple(_kind(a, where) for a in arguments), len(arguments))
    if isinstance(hint, type) and hint in _SCALARS:
        return _Scalar(hint)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        kinds = [kind for _, kind in schema(hint).fields]
        plain = len(kinds) > 1 and not hasattr(hint, "__post_init__")
        flat = plain and all(isinstance(kind, _Scalar) for kind in kinds)
        return _Flat(hint) if flat else _Nested(hint)
    raise MessageError(f"{where}: a field of type {hint} cannot travel")


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


def _say(item: Any) -> str:
    """A short description of hostile input, never the input itself."""
    size = f" of {len(item)}" if isinstance(item, (list, bytes, str)) else ""
    return f"{type(item).__name__}{size}"
