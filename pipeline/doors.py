"""The short way between processes of one host: packets from writer to reader, no thread between.

A reader has one unix socket in the graph's private folder and reads it on the thread that runs its
operator; a writer sends its descriptor straight into it. The kernel keeps packets whole and in
order. Where a reader does not drain its socket the writer hears that there is no room: a reader of
the latest then loses the packet and notices the gap in the numbers; credit keeps lossless ones far
from that, and a writer tries again for them.
"""

import contextlib
import os
import select
import socket
import struct
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

LARGEST_BYTES = 1 << 18  # above what a socket's buffer admits as one packet
MOST_ROUNDS = 256
_AT_ONCE = int(socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
_EDGE = struct.Struct("<I")  # a link's first packet says which edge it is


class Doors:
    """The reading side of one node. One thread waits; any may `wake` it."""

    def __init__(self, address: Path) -> None:
        self._address = address
        address.unlink(missing_ok=True)  # a killed predecessor's
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        self._listener.bind(str(address))
        self._listener.listen(64)
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.epoll()
        self._poll.register(self._listener, select.EPOLLIN)
        self._poll.register(self._bell, select.EPOLLIN)
        self._receivers: dict[int, Callable[[bytes], None]] = {}
        self._links: dict[int, tuple[socket.socket, Callable[[bytes], None] | None]] = {}
        self._buffer = memoryview(bytearray(LARGEST_BYTES))

    def expect(self, edge: int, receive: Callable[[bytes], None]) -> None:
        """Hand every packet of an edge to `receive`, on the waiting thread."""
        self._receivers[edge] = receive

    def wake(self) -> None:
        """Let `wait` return."""
        with contextlib.suppress(OSError):  # closed meanwhile
            os.eventfd_write(self._bell, 1)

    def wait(self, timeout_s: float) -> None:
        """Receive what has come; sleeps up to `timeout_s` while there is nothing."""
        ready = self._poll.poll(timeout_s)
        for _ in range(MOST_ROUNDS):  # a flood must not keep the operator from its work
            if not ready:
                return
            for handle, _event in ready:
                if handle in self._links:
                    self._read(handle)
                elif handle == self._bell:
                    with contextlib.suppress(BlockingIOError):
                        os.eventfd_read(self._bell)
                else:
                    self._accept()
            ready = self._poll.poll(0)

    def close(self) -> None:
        """Give back every socket."""
        for handle in list(self._links):
            self._drop(handle)
        self._poll.close()
        self._listener.close()
        self._address.unlink(missing_ok=True)
        os.close(self._bell)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            link, _ = self._listener.accept()
            link.setblocking(False)
            self._links[link.fileno()] = (link, None)
            self._poll.register(link, select.EPOLLIN)

    def _read(self, handle: int) -> None:
        """One packet; what is left makes the socket ready again."""
        link, receive = self._links[handle]
        try:
            size = link.recv_into(self._buffer)
        except BlockingIOError:
            return
        except OSError:
            size = 0
        if not size:
            self._drop(handle)
        elif receive is not None:
            receive(bytes(self._buffer[:size]))
        else:
            self._introduce(handle, link, bytes(self._buffer[:size]))

    def _introduce(self, handle: int, link: socket.socket, packet: bytes) -> None:
        known = len(packet) == _EDGE.size and self._receivers.get(_EDGE.unpack(packet)[0])
        if known:
            self._links[handle] = (link, known)
        else:
            self._drop(handle)

    def _drop(self, handle: int) -> None:
        link, _ = self._links.pop(handle)
        self._poll.unregister(handle)
        link.close()


class Links:
    """The writing side of one output: a link to every reader on this host."""

    def __init__(self, readers: Sequence[tuple[int, Path]]) -> None:
        self._readers = tuple(readers)  # edge, address
        self._links: dict[int, socket.socket] = {}

    def connect(self) -> bool:
        """Link up with readers that have opened their door since; True when one had."""
        if len(self._links) == len(self._readers):
            return False
        before = len(self._links)
        for edge, address in self._readers:
            if edge in self._links:
                continue
            link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            link.setblocking(False)
            try:
                link.connect(str(address))
                link.send(_EDGE.pack(edge))
                self._links[edge] = link
            except OSError:
                link.close()
        return len(self._links) > before

    def send(self, payload: bytes, only: Collection[int] | None = None) -> list[int]:
        """Hand a packet to the readers that are there; never waits. The edges without room."""
        full = []
        for edge, link in list(self._links.items()):
            if only is not None and edge not in only:
                continue
            try:
                link.send(payload, _AT_ONCE)
            except BlockingIOError:
                full.append(edge)
            except OSError:
                self._links.pop(edge).close()
        return full

    def close(self) -> None:
        """Give back every socket."""
        while self._links:
            self._links.popitem()[1].close()
