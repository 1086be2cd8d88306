"""Fingerprint the value of an attribute, in bounded time, to detect changes.

Objects that belong to a process (threads, locks, files, network sessions) count by identity. Values
that cannot be inspected, such as a filter of an extension module, are reported as opaque.
"""

import array
import collections
import datetime
import decimal
import enum
import fractions
import functools
import itertools
import operator
import pathlib
import queue
import random
import re
import sys
import types
import uuid
import zlib
from collections.abc import Iterable, Mapping
from itertools import islice
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

DEEPEST = 16  # nested containers and objects
MOST_ITEMS = 5000  # items inspected one by one in one attribute
MOST_PLAIN = 100_000  # numbers and strings of one list, which are fast to read
ENDS = 32  # of a longer container, this many at both ends and some between
MOST_BYTES = 1 << 20  # of an array that is hashed completely
MOST_SUMMED_BYTES = 1 << 26  # of an array that is summed, which detects most changes, too
_PLAIN = (bool, int, float, complex, str, bytes, type(None))
_PLAIN_TYPES = frozenset(_PLAIN)
_PRINTED = (
    datetime.date, datetime.time, datetime.timedelta, datetime.tzinfo, decimal.Decimal,
    fractions.Fraction, pathlib.PurePath, range, slice, enum.Enum, uuid.UUID, re.Pattern, np.dtype,
    itertools.count, itertools.repeat,
)  # fmt: skip
_NO_STATE = (
    type, types.ModuleType, types.FunctionType, types.BuiltinFunctionType, types.MethodType,
    types.MethodWrapperType, types.MappingProxyType, np.ufunc,
)  # fmt: skip
# objects of these modules belong to the process, or are networks, which inference leaves unchanged
_OF_THE_PROCESS = (
    "threading", "_thread", "logging", "socket", "_socket", "ssl", "_ssl", "io", "_io",
    "subprocess", "multiprocessing", "_multiprocessing", "concurrent", "asyncio", "_asyncio",
    "selectors", "select", "weakref", "_weakref", "_weakrefset", "tempfile", "ctypes", "_ctypes",
    "mmap", "importlib", "_frozen_importlib", "zipimport", "contextvars", "_contextvars",
    "typing", "onnxruntime", "rerun", "rerun_bindings", "zenoh", "usb",
)  # fmt: skip


class Fingerprint:
    """One inspection of a value. `opaque` is True if a part of it could not be inspected."""

    def __init__(self) -> None:
        self._left = MOST_ITEMS
        self._above: set[int] = set()  # objects being inspected, which may contain themselves
        self.opaque = False

    def of(self, value: Any, depth: int = 0) -> int:
        """Return a number that differs for another value."""
        self._left -= 1
        if isinstance(value, (*_PLAIN, np.generic, *_PRINTED)):
            return hash((type(value).__name__, repr(value)))
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            return hash((value.shape, value.dtype.str, of_array(value)))
        if isinstance(value, (bytearray, array.array)):
            return hash((type(value).__name__, len(value), zlib.crc32(value)))
        if depth >= DEEPEST or self._left <= 0 or id(value) in self._above:
            return hash((id(value), operator.length_hint(value, -1)))
        self._above.add(id(value))
        try:
            return self._of_many(value, depth + 1)
        finally:
            self._above.discard(id(value))

    def _of_many(self, value: Any, depth: int) -> int:
        if isinstance(value, Mapping):
            items = ((self.of(k, depth), self.of(v, depth)) for k, v in self._some(value.items()))
            return hash((len(value), *items))
        if isinstance(value, (list, tuple, collections.deque)):
            if len(value) <= MOST_PLAIN and set(map(type, value)) <= _PLAIN_TYPES:
                return of_plain(list(value))
            return hash((len(value), *(self.of(v, depth) for v in self._some(value))))
        if isinstance(value, (set, frozenset)):
            return hash((len(value), frozenset(self.of(v, depth) for v in self._some(value))))
        if isinstance(value, np.ndarray):  # an array of objects
            return hash((value.shape, *(self.of(v, depth) for v in self._some(value.ravel()))))
        inside = _inside(value)
        if inside is None:
            self.opaque = True
            return id(value)
        items = ((n, self.of(v, depth)) for n, v in self._some(inside.items()))
        return hash((type(value).__qualname__, *items))

    def _some(self, items: Iterable[Any]) -> Iterable[Any]:
        """Return all items, or within the limit both ends and some between."""
        count, room = len(items), max(0, self._left)  # type: ignore[arg-type]
        if count <= room:
            return tuple(items)
        between = max(1, count // (max(ENDS, room // 4)))
        ends = {*range(ENDS), *range(count - ENDS, count), *range(0, count, between)}
        return [item for index, item in enumerate(items) if index in ends]


def of_plain(values: list[Any]) -> int:
    """Hash all numbers and strings of a list."""
    try:
        return zlib.crc32(msgspec.msgpack.encode(values))
    except (TypeError, ValueError, OverflowError):  # an integer of 400 digits, or complex
        return hash(repr(values))


def of_array(values: NDArray[Any]) -> int:
    """Hash all bytes of a small array; of a large one the sum of its words and a sample."""
    if values.nbytes <= MOST_BYTES:
        return zlib.crc32(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    total = 0
    if values.nbytes <= MOST_SUMMED_BYTES and values.flags.c_contiguous:
        data = values.reshape(-1).view(np.uint8)
        words = data[: len(data) // 8 * 8].view(np.uint64)
        total = hash((int(words.sum(dtype=np.uint64)), data[len(words) * 8 :].tobytes()))
    while values.nbytes > MOST_BYTES // 8:
        axis = int(np.argmax(values.shape))
        values = values[(slice(None),) * axis + (slice(None, None, 3),)]
    return hash((total, zlib.crc32(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)))


def _inside(value: Any) -> Mapping[str, Any] | None:
    """Return an object's parts by name; empty for one without state, None for an opaque one."""
    if isinstance(value, _NO_STATE):
        return {"": id(value)}
    cls = type(value)
    package = cls.__module__.partition(".")[0]
    if package in _OF_THE_PROCESS or isinstance(value, type(sys.flags)):
        return {"": id(value)}
    if (found := _known(value, package)) is not None:
        return found
    slots = _slots(value)
    if isinstance(inside := getattr(value, "__dict__", None), dict):
        return {**slots, **inside} if slots else inside
    if slots or any("__slots__" in vars(base) for base in cls.__mro__) or cls is object:
        return slots or {"": id(value)}
    return None


def _known(value: Any, package: str) -> Mapping[str, Any] | None:
    """Return the parts of known objects without attributes of their own."""
    found: Mapping[str, Any] | None = None
    if isinstance(value, random.Random):
        found = {"state": value.getstate()}
    elif isinstance(value, np.random.Generator):
        found = {"state": value.bit_generator.state}
    elif isinstance(value, np.random.BitGenerator):
        found = {"state": value.state}
    elif isinstance(value, np.random.RandomState):
        found = {"state": value.get_state(legacy=False)}
    elif isinstance(value, queue.Queue):
        found = {"queue": value.queue}
    elif isinstance(value, queue.SimpleQueue):
        found = {"size": value.qsize()}
    elif isinstance(value, functools.partial):
        found = {"func": value.func, "args": value.args, "keywords": value.keywords}
    elif isinstance(value, types.GeneratorType):
        found = {"at": value.gi_frame.f_lasti if value.gi_frame else -1}
    elif package == "torch" and isinstance(version := getattr(value, "_version", None), int):
        found = {"": id(value), "version": version}  # incremented by changes in place
    elif isinstance(fields := getattr(type(value), "__struct_fields__", None), tuple):
        found = {n: getattr(value, n, None) for n in fields}
    elif (left := operator.length_hint(value, -1)) >= 0 and hasattr(type(value), "__next__"):
        found = {"": id(value), "left": left}
    return found


def _slots(value: Any) -> dict[str, Any]:
    """Return the attributes in `__slots__`."""
    found: dict[str, Any] = {}
    for base in type(value).__mro__:
        for member in islice(vars(base).values(), MOST_ITEMS):
            if isinstance(member, types.MemberDescriptorType):
                try:
                    found[member.__name__] = member.__get__(value)
                except AttributeError:  # not set
                    continue
    return found
