"""Links to other hosts that give up a cable that was pulled, at once and altogether.

Zenoh offers no setting for either: what it sends waits for a dead connection for as long as the
kernel tries (minutes), and closing one waits until everything was acknowledged (SO_LINGER, ten
seconds), on a thread that serves its other links too. So a pulled cable silenced hosts whose cables
were in; and a link that was closed late, when the cable was in again, was taken for its successor,
which was then closed in its place on one side and never opened again.
"""

import contextlib
import ipaddress
import socket
import struct

import psutil

TCP = ("tcp", "tls")  # the protocols of locators that are a TCP connection
DEAD_MS = 1500  # without an acknowledgement; less than the lease that Zenoh has with a peer
_AT_ONCE = struct.pack("ii", 0, 0)
End = tuple[str, int]  # address, port


def hasten(own: str, other: str) -> bool:
    """Let this process's TCP connection from one locator to another not outlive its cable.

    A locator is as Zenoh tells it, `tls/10.0.0.1:7447`; connections between others stay as they
    are, and so does what is no TCP connection. True when there is one.
    """
    if own.partition("/")[0] not in TCP:
        return False
    wanted = (_end(own), _end(other))
    for link in psutil.Process().net_connections("tcp"):
        if link.raddr and (_plain(*link.laddr), _plain(*link.raddr)) == wanted:
            with contextlib.suppress(OSError):  # closed meanwhile
                _hasten(link.fd)
                return True
    return False


def _hasten(number: int) -> None:
    borrowed = socket.socket(fileno=number)
    try:
        borrowed.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
        borrowed.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_MS)
    finally:
        borrowed.detach()  # it stays its owner's


def _end(locator: str) -> End:
    place = locator.partition("/")[2].partition("?")[0].partition("#")[0]
    host, _, port = place.rpartition(":")
    return _plain(host.strip("[]"), int(port))


def _plain(host: str, port: int) -> End:
    """One way to write an address: a socket for both kinds tells IPv4 ones as IPv6."""
    address = ipaddress.ip_address(host)
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return str(mapped or address), port
