"""How one field of a message travels: its text in the schema, its type for msgspec, its arrays."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError
from pipeline.messages import Shape

PlaceArray = Callable[[NDArray[Any]], bytes | int]  # puts an array somewhere: bytes or an offset
Fetch = Callable[[int, int], NDArray[np.uint8]]  # offset, nbytes -> (nbytes,) uint8
Side = Annotated[int, msgspec.Meta(ge=0)]

DTYPES = {np.dtype(t).str: np.dtype(t) for t in ("?", "u1", "u2", "i4", "i8", "f4", "f8", "u8")}


class Whole(Protocol):
    """What a field that is a dataclass needs to know of it."""

    text: str
    wire: type[Any]

    def write(self, value: Any, place: PlaceArray) -> Any:
        """What msgspec is to encode in the place of a value."""
        ...

    def build(self, wire: Any, fetch: Fetch) -> Any:
        """The value in whose place msgspec decoded `wire`."""
        ...


class Kind(ABC):
    """How one field is written and read."""

    plain = False  # msgspec writes and reads it as it is

    def __init__(self, text: str, wire: Any) -> None:
        self.text, self.wire = text, wire

    @abstractmethod
    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any: ...

    @abstractmethod
    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any: ...


class Plain(Kind):
    """Numbers, texts, and tuples and dataclasses of them."""

    plain = True

    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any:
        return value

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        return item


class Tuples(Kind):
    """A tuple with arrays somewhere inside."""

    def __init__(self, text: str, wire: Any, items: tuple[Kind, ...], *, endless: bool) -> None:
        super().__init__(text, wire)
        self.items, self.endless = items, endless

    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any:
        pairs = zip(self._kinds(value), value, strict=True)
        return tuple(kind.pack(item, place, known, where) for kind, item in pairs)

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        pairs = zip(self._kinds(item), item, strict=True)
        return tuple(kind.unpack(part, fetch, known, where) for kind, part in pairs)

    def _kinds(self, value: tuple[Any, ...]) -> tuple[Kind, ...]:
        return self.items * len(value) if self.endless else self.items


class Nested(Kind):
    """A dataclass with arrays somewhere inside."""

    def __init__(self, schema: Whole) -> None:
        super().__init__(schema.text, schema.wire)
        self.schema = schema

    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any:
        return self.schema.write(value, place)

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        return self.schema.build(item, fetch)


class _Spot(msgspec.Struct, array_like=True, forbid_unknown_fields=True, gc=False):
    """An array on the wire."""

    dtype: str
    sides: tuple[Side, ...]
    spot: bytes | Side  # its bytes, or where they begin in the pool's slot


class Array(Kind):
    """An array; its dtype, its sides and where it lies are checked before it is made."""

    def __init__(self, dtypes: frozenset[str], shape: Shape | None) -> None:
        super().__init__(f"array[{'|'.join(sorted(dtypes))}]{shape or ''}", _Spot)
        self.dtypes, self.shape = dtypes, shape
        self.alone = False  # in its message: its sides agree with no others
        self._fitting: tuple[int, ...] | None = None  # the last sides, when it is alone

    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any:
        self._check(value, known, where)
        return (value.dtype.str, value.shape, place(value))

    def carried(self, value: Any, known: dict[str, int], where: str) -> NDArray[Any]:
        """The array as `unpack` gives it: read-only, in one piece; a view where it is in one."""
        self._check(value, known, where)
        view: NDArray[Any] = np.asarray(value)
        view = view.view() if view.flags.c_contiguous else view.copy(order="C")
        view.flags.writeable = False
        return view

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        if item.dtype not in self.dtypes:
            raise MessageError(f"{where}: expected {self.text}, got another kind of array")
        dtype, sides, spot = DTYPES[item.dtype], item.sides, item.spot
        nbytes = dtype.itemsize * math.prod(sides)
        if type(spot) is bytes:
            raw = np.frombuffer(spot, np.uint8)
        elif spot % dtype.itemsize == 0:
            raw = fetch(spot, nbytes)
        else:
            raise MessageError(f"{where}: expected an offset of whole items, got {spot}")
        if raw.nbytes != nbytes:
            raise MessageError(f"{where}: expected {nbytes} bytes for {sides}, got {raw.nbytes}")
        if sides != self._fitting:
            self._check_sides(sides, known, where)
        try:
            array: NDArray[Any] = np.ndarray(sides, dtype, raw)
        except (ValueError, OverflowError) as error:  # nothing, as 0 x 2^63, is too big as well
            raise MessageError(f"{where}: no array has the sides {sides}") from error
        return array

    def _check(self, value: Any, known: dict[str, int], where: str) -> None:
        if not isinstance(value, np.ndarray) or value.dtype.str not in self.dtypes:
            got = value.dtype.str if isinstance(value, np.ndarray) else type(value).__name__
            raise MessageError(f"{where}: expected {self.text}, got {got}")
        if value.shape != self._fitting:
            self._check_sides(value.shape, known, where)

    def _check_sides(self, sides: tuple[int, ...], known: dict[str, int], where: str) -> None:
        if self.shape:
            self.shape.check(where, sides, known)
        if self.alone:
            self._fitting = sides
