"""Direct transport between processes of one host: packets from writer to reader, without a thread.

A reader has one unix socket in the graph's private folder and reads it on the thread that runs its
operator; writers send descriptors directly to it. The kernel keeps packets whole and in order.
When a reader does not drain its socket, the writer gets an error: a `keep="latest"` reader loses
the packet and notices the gap in the ordinals. Credit normally prevents this for lossless readers,
and the writer retries for them.
"""

import contextlib
import os
import select
import socket
import struct
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

LARGEST_BYTES = 1 << 18  # more than a socket buffer accepts as one packet
MOST_ROUNDS = 256
_AT_ONCE = int(socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
_EDGE = struct.Struct("<I")  # the first packet of a link contains the edge
_UNKNOWN = -1
Target = tuple[int, Path]  # edge and address of a receiver


class LocalReceiver:
    """The reading side of one node. One thread waits; any thread may `wake` it."""

    def __init__(self, address: Path) -> None:
        self._address = address
        address.unlink(missing_ok=True)  # of a killed predecessor
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        self._listener.bind(str(address))
        self._listener.listen(64)
        self._wakeup = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.epoll()
        self._poll.register(self._listener, select.EPOLLIN)
        self._poll.register(self._wakeup, select.EPOLLIN)
        self._receivers: dict[int, Callable[[bytes], None]] = {}
        self._links: dict[int, tuple[socket.socket, int]] = {}  # by handle: socket, edge
        self._lines: dict[int, list[int]] = {}  # by edge: handles, the oldest link first
        self._buffer = memoryview(bytearray(LARGEST_BYTES))

    def expect(self, edge: int, receive: Callable[[bytes], None]) -> None:
        """Pass every packet of an edge to `receive`, on the waiting thread."""
        self._receivers[edge] = receive

    def wake(self) -> None:
        """Make `wait` return."""
        with contextlib.suppress(OSError):  # already closed
            os.eventfd_write(self._wakeup, 1)

    def wait(self, timeout_s: float) -> None:
        """Receive pending packets; sleep up to `timeout_s` while there are none."""
        ready = self._poll.poll(timeout_s)
        for _ in range(MOST_ROUNDS):  # a flood of packets must not starve the operator
            if not ready:
                return
            for handle, _event in ready:
                if handle in self._links:
                    self._read(handle)
                elif handle == self._wakeup:
                    with contextlib.suppress(BlockingIOError):
                        os.eventfd_read(self._wakeup)
                else:
                    self._accept()
            ready = self._poll.poll(0)

    def close(self) -> None:
        """Close every socket."""
        for handle in list(self._links):
            self._drop(handle)
        self._poll.close()
        self._listener.close()
        self._address.unlink(missing_ok=True)
        os.close(self._wakeup)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            link, _ = self._listener.accept()
            link.setblocking(False)
            self._links[link.fileno()] = (link, _UNKNOWN)
            self._poll.register(link, select.EPOLLIN)

    def _read(self, handle: int) -> None:
        """Read one packet; if more are left, the socket becomes ready again.

        Packets of a writer's predecessor are read before the writer's own.
        """
        for older in list(self._lines.get(self._links[handle][1], ())):
            if older == handle:
                break
            while self._read_one(older):
                pass
        self._read_one(handle)

    def _read_one(self, handle: int) -> bool:
        """Read one packet; return whether there was one."""
        link, edge = self._links[handle]
        try:
            size = link.recv_into(self._buffer)
        except BlockingIOError:
            return False
        except OSError:
            size = 0
        if not size:
            self._drop(handle)
            return False
        packet = bytes(self._buffer[:size])
        if edge == _UNKNOWN:
            self._handshake(handle, link, packet)
        else:
            self._receivers[edge](packet)
        return True

    def _handshake(self, handle: int, link: socket.socket, packet: bytes) -> None:
        edge = _EDGE.unpack(packet)[0] if len(packet) == _EDGE.size else _UNKNOWN
        if edge in self._receivers:
            self._links[handle] = (link, edge)
            self._lines.setdefault(edge, []).append(handle)
        else:
            self._drop(handle)

    def _drop(self, handle: int) -> None:
        link, edge = self._links.pop(handle)
        if edge != _UNKNOWN:
            self._lines[edge].remove(handle)
        self._poll.unregister(handle)
        link.close()


class LocalSender:
    """The writing side of one output: a link to every reader on this host."""

    def __init__(self, readers: Sequence[Target] = ()) -> None:
        self._links: dict[Target, socket.socket] = {}
        self.set_targets(readers)

    def set_targets(self, readers: Sequence[Target], beside: Sequence[Target] = ()) -> None:
        """Set the targets of packets; `beside` are those that no writer waits for."""
        self._readers, self._beside = (*readers, *beside), frozenset(beside)
        for target in self._links.keys() - set(self._readers):
            self._links.pop(target).close()

    def connect(self) -> bool:
        """Connect to readers that have opened their receiver since; return whether one had."""
        if len(self._links) == len(self._readers):
            return False
        before = len(self._links)
        for target in self._readers:
            if target not in self._links and (link := connect(*target)):
                self._links[target] = link
        return len(self._links) > before

    def send(self, payload: bytes, only: Collection[Target] | None = None) -> list[Target]:
        """Send a packet to the connected readers, without waiting; return those without room."""
        full = []
        for target, link in list(self._links.items()):
            if only is not None and target not in only:
                continue
            try:
                link.send(payload, _AT_ONCE)
            except BlockingIOError:
                if target not in self._beside:
                    full.append(target)
            except OSError:
                self._links.pop(target).close()
        return full

    def close(self) -> None:
        """Close every socket."""
        while self._links:
            self._links.popitem()[1].close()


def connect(edge: int, address: Path) -> socket.socket | None:
    """Return a link to a receiver after the handshake; None while there is no receiver."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    link.setblocking(False)
    try:
        link.connect(str(address))
        link.send(_EDGE.pack(edge))
    except OSError:
        link.close()
        return None
    return link
