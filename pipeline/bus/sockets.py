"""TCP options that make links to other hosts fail fast after a network failure.

Zenoh has no settings for this: sending blocks on a dead connection for as long as the kernel
retries (minutes), and closing one waits until all data is acknowledged (SO_LINGER, ten seconds), on
a thread that also serves other links. A pulled cable therefore silenced hosts whose cables were
plugged in. And a link that was closed late, after the cable was back, was mistaken for its
successor, which was then closed instead on one side and never reopened.
"""

import contextlib
import ipaddress
import socket
import struct

import psutil

TCP = ("tcp", "tls")  # protocols of locators that use TCP
DEAD_MS = 1500  # without an acknowledgement; less than Zenoh's lease
_AT_ONCE = struct.pack("ii", 0, 0)
End = tuple[str, int]  # address, port


def hasten(own: str, other: str) -> bool:
    """Make this process's TCP connection between two locators fail fast.

    Locators are in Zenoh's form, `tls/10.0.0.1:7447`. Other connections stay as they are. Returns
    whether there is such a TCP connection.
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
        borrowed.detach()  # the owner keeps the descriptor


def _end(locator: str) -> End:
    place = locator.partition("/")[2].partition("?")[0].partition("#")[0]
    host, _, port = place.rpartition(":")
    return _plain(host.strip("[]"), int(port))


def _plain(host: str, port: int) -> End:
    """Normalise an address: dual-stack sockets report IPv4 ones as IPv6."""
    address = ipaddress.ip_address(host)
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return str(mapped or address), port
