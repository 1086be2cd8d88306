"""Direct transport between processes of one host: packets from writer to reader, no thread between.

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
_UNKNOWN = -1
Target = tuple[int, Path]  # edge and address of a receiver


class LocalReceiver:
    """The reading side of one node. One thread waits; any may `wake` it."""

    def __init__(self, address: Path) -> None:
        self._address = address
        address.unlink(missing_ok=True)  # a killed predecessor's
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
        """Hand every packet of an edge to `receive`, on the waiting thread."""
        self._receivers[edge] = receive

    def wake(self) -> None:
        """Let `wait` return."""
        with contextlib.suppress(OSError):  # closed meanwhile
            os.eventfd_write(self._wakeup, 1)

    def wait(self, timeout_s: float) -> None:
        """Receive what has come; sleeps up to `timeout_s` while there is nothing."""
        ready = self._poll.poll(timeout_s)
        for _ in range(MOST_ROUNDS):  # a flood must not keep the operator from its work
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
        """Give back every socket."""
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
        """One packet; what is left makes the socket ready again.

        Where a writer has had a successor, what the older one sent is read before.
        """
        for older in list(self._lines.get(self._links[handle][1], ())):
            if older == handle:
                break
            while self._read_one(older):
                pass
        self._read_one(handle)

    def _read_one(self, handle: int) -> bool:
        """Whether there was a packet."""
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
        """From now on packets go to these; `beside` are those that nobody is held up for."""
        self._readers, self._beside = (*readers, *beside), frozenset(beside)
        for target in self._links.keys() - set(self._readers):
            self._links.pop(target).close()

    def connect(self) -> bool:
        """Connect to readers that have opened their receiver since; True when one had."""
        if len(self._links) == len(self._readers):
            return False
        before = len(self._links)
        for target in self._readers:
            if target not in self._links and (link := connect(*target)):
                self._links[target] = link
        return len(self._links) > before

    def send(self, payload: bytes, only: Collection[Target] | None = None) -> list[Target]:
        """Hand a packet to the readers that are there; never waits. Those without room."""
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
        """Give back every socket."""
        while self._links:
            self._links.popitem()[1].close()


def connect(edge: int, address: Path) -> socket.socket | None:
    """A link to a receiver after the handshake; None while there is none."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    link.setblocking(False)
    try:
        link.connect(str(address))
        link.send(_EDGE.pack(edge))
    except OSError:
        link.close()
        return None
    return link
