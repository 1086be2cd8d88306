"""FunctionFS: a USB function as files, ep0 for requests and one for each end point.

The layout of descriptors and events is that of the kernel's include/uapi/linux/usb/functionfs.h.
"""

import ctypes
import errno
import os
import select
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import TypeVar

from drivers.virtual_board.descriptors import ENDPOINTS, MAX_PACKET_BYTES, interface_descriptors
from drivers.virtual_board.setup_packet import SetupPacket
from pipeline.errors import DriverError

DESCRIPTORS, STRINGS = 3, 2  # magic numbers of what is written to ep0 first
FULL, HIGH, SUPER = 1, 2, 4  # flags: speeds that descriptors follow for
PACKETS_BYTES = (64, 512, MAX_PACKET_BYTES)  # of a bulk end point, at these speeds
EVENT = struct.Struct("<8sB3x")
DETACH = 2  # MNT_DETACH
FOLDER = "fovea-gadget-"  # what the names of folders begin with that are made to mount it
MOUNTS = Path("/proc/self/mounts")
# what ep0 answers when the host has given a request up, has gone, or was refused as wanted
OVER = (errno.EIDRM, errno.ESRCH, errno.EL2HLT, errno.ESHUTDOWN, errno.ENODEV, errno.ECONNRESET)

T = TypeVar("T")
_libc = ctypes.CDLL(None, use_errno=True)


class EventKind(IntEnum):
    """What happens to a function."""

    BIND = 0
    UNBIND = 1
    ENABLE = 2  # the host has chosen the configuration
    DISABLE = 3  # reset or unplugged
    SETUP = 4  # a request
    SUSPEND = 5
    RESUME = 6


@dataclass(frozen=True)
class Event:
    """What has happened; `setup` counts with SETUP only."""

    kind: EventKind
    setup: SetupPacket


class FunctionFs:
    """The mounted function of a gadget; `close` is safe after any outcome."""

    def __init__(self, name: str) -> None:
        self._name, self._folder, self._control = name, Path(), -1
        self._mounted = False
        self._poll = select.poll()
        self._woken = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll.register(self._woken, select.POLLIN)

    def open(self) -> list[Path]:
        """Mount and describe the function; return its end points. Raises `DriverError`."""
        self._folder = Path(tempfile.mkdtemp(prefix=FOLDER))
        self._mounted = True  # before it is: a signal may come in between
        try:
            _mount(self._name, self._folder)
            self._control = os.open(self._folder / "ep0", os.O_RDWR)
            os.write(self._control, descriptor_block())
            os.write(self._control, struct.pack("<4I", STRINGS, 16, 0, 0))  # it names none
        except OSError as error:
            self.close()
            raise DriverError(
                f"gadget: functionfs {self._name}: cannot be mounted: {error.strerror}"
            ) from None
        self._poll.register(self._control, select.POLLIN)
        return [self._folder / f"ep{k + 1}" for k in range(len(ENDPOINTS))]

    def event(self, timeout_s: float) -> Event | None:
        """Return the next event; None: there was none in time, or `wake` was called."""
        ready = [file for file, _ in self._poll.poll(round(timeout_s * 1000))]
        if self._woken in ready:
            os.eventfd_read(self._woken)
        if self._control not in ready:
            return None
        data = _attempt(lambda: os.read(self._control, EVENT.size))
        if data is None:
            return None
        setup, kind = EVENT.unpack(data)
        return Event(EventKind(kind), SetupPacket.unpack(setup))

    def wake(self) -> None:
        """Let a wait for events return; another thread may call it."""
        os.eventfd_write(self._woken, 1)

    def answer(self, data: bytes) -> None:
        """Send what an IN request asks for."""
        _attempt(lambda: os.write(self._control, data))

    def take(self, length: int) -> bytes | None:
        """Return the data of an OUT request, and acknowledge it; None: the host gave up."""
        found = _attempt(lambda: os.read(self._control, length))
        return found if found is not None and len(found) == length else None

    def refuse(self, setup: SetupPacket) -> None:
        """Stall a request, which is done by going the wrong way."""
        if setup.reads:
            _attempt(lambda: os.read(self._control, 0))
        else:
            _attempt(lambda: os.write(self._control, b""))

    def close(self) -> None:
        """Close and unmount; the end points are closed by then."""
        if self._woken >= 0:
            os.close(self._woken)
            self._woken = -1
        if self._control >= 0:
            os.close(self._control)
            self._control = -1
        if self._mounted:
            self._mounted = False
            _libc.umount2(os.fsencode(self._folder), DETACH)
            self._folder.rmdir()


def descriptor_block() -> bytes:
    """Return what ep0 is given first: the interface as it is at each speed."""
    speeds = [interface_descriptors(packet_bytes) for packet_bytes in PACKETS_BYTES]
    body = struct.pack("<3I", *map(len, speeds)) + b"".join(map(b"".join, speeds))
    return struct.pack("<3I", DESCRIPTORS, 12 + len(body), FULL | HIGH | SUPER) + body


def unmount_leftovers(name: str, mounts: Path = MOUNTS) -> None:
    """Unmount what a killed program of this name left, in folders that it made."""
    for words in (line.split() for line in mounts.read_text().splitlines()):
        ours = Path(words[1]).name.startswith(FOLDER)
        if words[0] == name and words[2] == "functionfs" and ours:
            _libc.umount2(os.fsencode(words[1]), DETACH)
            Path(words[1]).rmdir()


def _mount(name: str, folder: Path) -> None:
    if _libc.mount(name.encode(), os.fsencode(folder), b"functionfs", ctypes.c_ulong(0), None):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _attempt(act: Callable[[], T]) -> T | None:
    """Return what the request came to, None where the host no longer waits for it."""
    try:
        return act()
    except OSError as error:
        if error.errno in OVER:
            return None
        raise
