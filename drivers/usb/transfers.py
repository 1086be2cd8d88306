"""Several bulk reads in flight at a time, over the libusb that pyusb has loaded.

pyusb itself reads one buffer after the other, and the board waits in between. Prototypes are made
per function and not set on pyusb's library object, which all its users share.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from ctypes import (
    CDLL,
    CFUNCTYPE,
    POINTER,
    Structure,
    byref,
    c_int,
    c_long,
    c_ubyte,
    c_uint,
    c_void_p,
)
from typing import Any

from drivers.usb.errors import LinkError, NoUsbMemory, Overflow, Stalled, Unplugged
from drivers.usb.part import Part

BULK = 2
NO_DEVICE, NO_MEMORY = -4, -11  # of a submission
CANCEL_S = 5.0  # in which cancelled reads have to return
COMPLETED, CANCELLED = 0, 3
FAILURES: dict[int, tuple[type[LinkError], str]] = {
    1: (Unplugged, "a read failed"),
    4: (Stalled, "an end point is halted"),
    5: (Unplugged, "the board is gone"),
    6: (Overflow, "the board sent more than was asked for"),
}

log = logging.getLogger(__name__)


class _Transfer(Structure):
    """`struct libusb_transfer` without its isochronous packets."""


_CALLBACK = CFUNCTYPE(None, POINTER(_Transfer))
_Transfer._fields_ = [
    ("handle", c_void_p), ("flags", c_ubyte), ("endpoint", c_ubyte), ("type", c_ubyte),
    ("timeout", c_uint), ("status", c_int), ("length", c_int), ("actual", c_int),
    ("callback", _CALLBACK), ("user_data", c_void_p), ("buffer", c_void_p), ("packets", c_int),
]  # fmt: skip


class _Moment(Structure):
    """`struct timeval`."""

    _fields_ = [("s", c_long), ("us", c_long)]


class _Library:
    """The functions of libusb that are needed here."""

    def __init__(self, library: CDLL) -> None:
        transfer = POINTER(_Transfer)

        def function(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
            found: Callable[..., Any] = CFUNCTYPE(result, *arguments)((name, library))
            return found

        self.allocate = function("libusb_alloc_transfer", transfer, c_int)
        self.free = function("libusb_free_transfer", None, transfer)
        self.submit = function("libusb_submit_transfer", c_int, transfer)
        self.cancel = function("libusb_cancel_transfer", c_int, transfer)
        self.handle_events = function(
            "libusb_handle_events_timeout_completed", c_int, c_void_p, POINTER(_Moment),
            POINTER(c_int),
        )  # fmt: skip


class _Slot:
    """One transfer, and the chunk that it reads."""

    def __init__(self, number: int, transfer: Any) -> None:
        self.number, self.transfer = number, transfer
        self.part: Part | None = None
        self.start = 0


class InFlight:
    """Reads of the end points of an opened device; used by one thread."""

    def __init__(
        self, library: CDLL, context: Any, handle: Any, endpoints: Sequence[int], *,
        chunk_bytes: int, depth: int,
    ) -> None:  # fmt: skip
        self._usb, self._context, self._endpoints = _Library(library), context, endpoints
        self._chunk_bytes, self.depth = chunk_bytes, depth
        self._done: deque[int] = deque()  # numbers of slots whose transfer has returned
        self._woken = c_int(0)
        self._callback = _CALLBACK(self._returned)
        self._slots = [_Slot(k, self._usb.allocate(0)) for k in range(depth)]
        for slot in self._slots:
            found = slot.transfer.contents
            found.handle, found.type, found.callback = handle, BULK, self._callback
            found.user_data = slot.number + 1  # 0 would read as None

    def receive(self, parts: Sequence[Part], timeout_s: float, ahead: Sequence[Part] = ()) -> None:
        """Fill parts until each is over or the time is; see `Link.receive`."""
        deadline_s = time.monotonic() + timeout_s
        wanted = [*parts, *ahead]
        try:
            self._end(lambda part: part.short or not any(part is one for one in wanted))
            while True:
                self._collect()
                if failed := next((part.failure for part in parts if part.failure), None):
                    raise failed
                self._submit(wanted)
                left_s = deadline_s - time.monotonic()
                if left_s <= 0 or all(part.over for part in parts):
                    break
                self._wait(left_s)
            self._end(lambda part: part.short or not ahead)
        except BaseException:
            self.cancel()
            raise

    def cancel(self, stream: int | None = None) -> None:
        """End the reads of a stream, or all; nothing is written to their memory any more."""
        self._end(lambda part: stream in (None, part.stream))

    def close(self) -> None:
        """Free the transfers; those that do not return are left to the library."""
        with suppress(LinkError):
            self.cancel()
        for slot in self._slots:
            if slot.part is None:
                self._usb.free(slot.transfer)
        self._slots = []

    def _submit(self, parts: Sequence[Part]) -> None:
        """Submit reads of parts, in their order, as far as there is room for them."""
        left = deque(p for p in parts if not (p.short or p.failure or p.submitted == len(p)))
        for slot in self._slots[: self.depth]:
            if slot.part is not None or not left:
                continue
            part = left[0]
            length = min(self._chunk_bytes, len(part) - part.submitted)
            found = slot.transfer.contents
            found.endpoint = self._endpoints[part.stream]
            found.buffer, found.length = part.memory.ctypes.data + part.submitted, length
            result = self._usb.submit(slot.transfer)
            if result == NO_MEMORY:
                self._halve()
                return
            if result:
                raise Unplugged("the board is gone" if result == NO_DEVICE else "a read failed")
            slot.part, slot.start = part, part.submitted
            part.submitted += length
            if part.submitted == len(part):
                left.popleft()

    def _halve(self) -> None:
        if not self._busy():
            raise NoUsbMemory(
                "the kernel grants no memory for a single read; see "
                "/sys/module/usbcore/parameters/usbfs_memory_mb"
            )
        if self.depth == 1:  # it is granted when what is in flight has returned
            return
        self.depth //= 2
        log.warning(
            "usb: no memory for more reads in flight, %d from now on; "
            "/sys/module/usbcore/parameters/usbfs_memory_mb limits it",
            self.depth,
        )

    def _busy(self) -> int:
        return sum(slot.part is not None for slot in self._slots)

    def _collect(self) -> None:
        """Account for what has returned; a read that failed is a failure of its part."""
        while self._done:
            slot = self._slots[self._done.popleft()]
            part, slot.part = slot.part, None
            found = slot.transfer.contents
            if part is not None and found.status not in (COMPLETED, CANCELLED):
                kind, why = FAILURES.get(found.status, (LinkError, "a read failed"))
                part.failure = kind(why)
            if part is not None and part.received == slot.start and not part.short:
                part.received += found.actual
                if found.status == COMPLETED and found.actual < found.length:
                    part.short = True
                    self._cancel(part)

    def _cancel(self, part: Part) -> None:
        """Cancel what would read on behind the end of a part."""
        for slot in self._slots:
            if slot.part is part:
                self._usb.cancel(slot.transfer)

    def _end(self, ends: Callable[[Part], bool]) -> None:
        """Cancel and await reads of some parts, so that their memory is not written later."""
        slots = [slot for slot in self._slots if slot.part is not None and ends(slot.part)]
        if not slots:
            return
        ended = {id(slot.part): slot.part for slot in slots}
        for slot in slots:
            if slot.number not in self._done:
                self._usb.cancel(slot.transfer)
        deadline_s = time.monotonic() + CANCEL_S
        while any(slot.part is not None and slot.number not in self._done for slot in slots):
            if time.monotonic() > deadline_s:
                raise Unplugged("reads in flight cannot be cancelled")
            self._wait(0.1, slots)
        self._collect()
        for part in ended.values():
            if part is not None:
                part.submitted = part.received

    def _wait(self, limit_s: float, slots: "Sequence[_Slot] | None" = None) -> None:
        """Wait until a read has returned, or one of these slots."""
        self._woken.value = 0  # first: another thread that handles events may set it at any time
        if self._done and (slots is None or all(s.number in self._done for s in slots)):
            return
        limit_us = max(0, round(limit_s * 1e6))
        moment = _Moment(limit_us // 1_000_000, limit_us % 1_000_000)
        self._usb.handle_events(self._context, byref(moment), byref(self._woken))

    def _returned(self, transfer: Any) -> None:
        self._done.append(transfer.contents.user_data - 1)
        self._woken.value = 1
