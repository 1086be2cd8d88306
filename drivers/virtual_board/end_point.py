"""A bulk IN end point of FunctionFS, and the thread that sends a virtual board's stream on it."""

import ctypes
import errno
import fcntl
import logging
import os
import signal
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.usb.frame_header import HEADER_BYTES, Stream
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.errors import Gone, Halted, TooMuch
from pipeline.errors import DriverError

CHUNK_BYTES = 64 << 10  # of one write: the kernel copies it to memory that is contiguous
READ_S = 0.5  # of a read of the board; a request ends it
WAKE = signal.SIGUSR1  # interrupts a write that waits for the host
WAKE_S, PARK_S = 0.005, 5.0  # between attempts to interrupt it, and in all
HALT_S = 1.0  # in which the host takes what was sent before
ENDPOINT_DESCRIPTOR = 2 << 30 | 9 << 16 | ord("g") << 8 | 130  # FUNCTIONFS_ENDPOINT_DESC
GONE = (errno.EINTR, errno.ESHUTDOWN, errno.ENODEV, errno.ECONNRESET)
# where the header of a frame tells its length; its checksum may be wrong on purpose
PAYLOAD_BYTES = struct.Struct("<52xI")

log = logging.getLogger(__name__)
_libc = ctypes.CDLL(None, use_errno=True)
for _function in (_libc.read, _libc.write):
    _function.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t)
    _function.restype = ctypes.c_ssize_t


class Interrupted(Exception):
    """A write was ended before the host had taken all of it."""


class EndPoint:
    """One end point as a file. Built once its function is described."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR)

    def packet_bytes(self) -> int:
        """Return the size of a packet at the speed of the link; raises `Interrupted`."""
        descriptor = bytearray(9)
        try:
            fcntl.ioctl(self._file, ENDPOINT_DESCRIPTOR, descriptor)
        except OSError as error:
            if error.errno in GONE:
                raise Interrupted from None
            raise
        return int.from_bytes(descriptor[4:6], "little")

    def write(self, data: NDArray[np.uint8]) -> None:
        """Wait until the host has taken the data; raises `Interrupted` when that is cut short."""
        written, number = self._call(_libc.write, data)
        if number and number not in GONE:
            raise OSError(number, os.strerror(number))
        if written != len(data):
            raise Interrupted

    def halt(self) -> None:
        """Stall the end point until the host clears that."""
        deadline_s = time.monotonic() + HALT_S
        nothing = np.empty(1, np.uint8)
        # the wrong way, which halts it, unless something still waits for the host
        while self._call(_libc.read, nothing)[1] == errno.EAGAIN and time.monotonic() < deadline_s:
            time.sleep(WAKE_S)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def _call(self, function: Any, data: NDArray[np.uint8]) -> tuple[int, int]:
        """Return what it returns, and the number of its error.

        Functions of `os` go on after a signal, with data that shall not be sent any more.
        """
        count = function(self._file, data.ctypes.data, len(data))
        return count, ctypes.get_errno() if count < 0 else 0


class StreamWriter:
    """Sends the frames of one stream while it is let; the handler of `WAKE` must be set.

    When it cannot go on, `gone` or `failure` says why, and it calls `ended`.
    """

    def __init__(
        self, board: VirtualBoard, stream: Stream, end_point: EndPoint,
        ended: Callable[[], None],
    ) -> None:  # fmt: skip
        self._board, self._stream, self._end_point = board, stream, end_point
        self._ended = ended
        self._memory = np.empty(CHUNK_BYTES, np.uint8)
        self._turn = threading.Condition()
        self._going = self._ending = False
        self._busy = True  # the thread does something else than wait for its turn
        self.gone = False  # the board has unplugged itself
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def go(self) -> None:
        """Let it send."""
        with self._turn:
            self._going = True
            self._turn.notify_all()

    def park(self) -> None:
        """Drop what it is sending, and forget an unplugging. Raises `DriverError`.

        Nothing more is sent when this returns.
        """
        deadline_s = time.monotonic() + PARK_S
        with self._turn:
            self._going = False
            while self._busy:
                if time.monotonic() > deadline_s:
                    raise DriverError("gadget: the controller does not give a transfer back")
                # again and again: a signal just before the write does not interrupt it
                signal.pthread_kill(self._thread.ident or 0, WAKE)
                self._turn.wait(WAKE_S)
            self.gone = False

    def close(self) -> None:
        """End the thread and close the end point."""
        with self._turn:
            self._ending = True
            self._turn.notify_all()
        self.park()
        self._thread.join(PARK_S)
        self._end_point.close()

    def _run(self) -> None:
        while self._its_turn():
            try:
                self._send_frame()
            except Gone:
                self._going, self.gone = False, True
                self._ended()
            except Exception as error:  # its owner raises it; a thread that ended cannot be parked
                self._going, self.failure = False, error
                self._ended()

    def _its_turn(self) -> bool:
        """Wait until it may send; False: never again."""
        with self._turn:
            self._busy = False
            self._turn.notify_all()
            self._turn.wait_for(lambda: self._going or self._ending)
            self._busy = not self._ending
            return self._busy

    def _send_frame(self) -> None:
        """Send the next frame, if there is one."""
        header = self._memory[:HEADER_BYTES]
        if self._board.read(self._stream, header, READ_S) is None:
            return
        (left,) = PAYLOAD_BYTES.unpack_from(header.data)
        try:
            self._write(header)
            self._send_payload(left)
        except Interrupted:
            self._board.clear_halt(self._stream)  # a header follows
        except Halted:
            self._end_point.halt()
            # the host clears that without this program's notice
            self._board.clear_halt(self._stream)

    def _send_payload(self, left: int) -> None:
        while left:
            piece = self._memory[: min(left, CHUNK_BYTES)]
            try:
                count = self._board.read(self._stream, piece, READ_S)
            except TooMuch:
                self._send_too_much(left)
                return
            if count is None:
                return  # it was stopped
            self._write(piece[:count])
            left -= count
            if count < len(piece):
                if count and count % self._end_point.packet_bytes() == 0:
                    self._write(piece[:0])  # the end does not show otherwise
                return

    def _send_too_much(self, left: int) -> None:
        """Send whole packets, more than the host asks for."""
        packet_bytes = self._end_point.packet_bytes()
        self._memory[:] = 0
        left = (left // packet_bytes + 2) * packet_bytes
        while left:
            piece = self._memory[: min(left, CHUNK_BYTES)]
            self._write(piece)
            left -= len(piece)

    def _write(self, data: NDArray[np.uint8]) -> None:
        if not self._going:
            raise Interrupted
        self._end_point.write(data)
