"""Encoding of one message field: its schema text, its msgspec type and its arrays."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError
from pipeline.messages import Shape

PlaceArray = Callable[[NDArray[Any]], bytes | int]  # stores an array: its bytes or offset
Fetch = Callable[[int, int], NDArray[np.uint8]]  # offset, nbytes -> (nbytes,) uint8
Side = Annotated[int, msgspec.Meta(ge=0)]

DTYPES = {np.dtype(t).str: np.dtype(t) for t in ("?", "u1", "u2", "i4", "i8", "f4", "f8", "u8")}


class Whole(Protocol):
    """The encoder and decoder of a dataclass, as `Nested` uses them."""

    text: str
    wire: type[Any]

    def write(self, value: Any, place: PlaceArray) -> Any:
        """Return the object that msgspec encodes for a value."""
        ...

    def build(self, wire: Any, fetch: Fetch) -> Any:
        """Return the value for the object that msgspec decoded."""
        ...


class Kind(ABC):
    """How one field is written and read."""

    plain = False  # msgspec encodes and decodes it without help

    def __init__(self, text: str, wire: Any) -> None:
        self.text, self.wire = text, wire

    @abstractmethod
    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any: ...

    @abstractmethod
    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any: ...


class Plain(Kind):
    """Numbers, strings, and tuples and dataclasses of them."""

    plain = True

    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any:
        return value

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        return item


class Tuples(Kind):
    """A tuple that contains arrays at any depth."""

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
    """A dataclass that contains arrays at any depth."""

    def __init__(self, schema: Whole) -> None:
        super().__init__(schema.text, schema.wire)
        self.schema = schema

    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any:
        return self.schema.write(value, place)

    def unpack(self, item: Any, fetch: Fetch, known: dict[str, int], where: str) -> Any:
        return self.schema.build(item, fetch)


class _Spot(msgspec.Struct, array_like=True, forbid_unknown_fields=True, gc=False):
    """The encoding of an array: dtype, shape, and bytes or offset."""

    dtype: str
    sides: tuple[Side, ...]
    spot: bytes | Side  # its bytes, or their offset in the pool's slot


class Array(Kind):
    """An array; its dtype, shape and offset are checked before it is created."""

    def __init__(self, dtypes: frozenset[str], shape: Shape | None) -> None:
        super().__init__(f"array[{'|'.join(sorted(dtypes))}]{shape or ''}", _Spot)
        self.dtypes, self.shape = dtypes, shape
        self.alone = False  # no other array of the message shares one of its named sides
        self._fitting: tuple[int, ...] | None = None  # the last valid shape, when it is alone

    def pack(self, value: Any, place: PlaceArray, known: dict[str, int], where: str) -> Any:
        self._check(value, known, where)
        return (value.dtype.str, value.shape, place(value))

    def carried(self, value: Any, known: dict[str, int], where: str) -> NDArray[Any]:
        """Return the array as `unpack` would: read-only and contiguous, a view if possible."""
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
        except (ValueError, OverflowError) as error:  # even an empty array, as 0 x 2^63
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
