"""TCP options that make links to other hosts fail fast after a network failure.

Zenoh has no settings for this: sending blocks on a dead connection for as long as the kernel
retries (minutes), and closing one waits until all data is acknowledged (SO_LINGER, ten seconds), on
a thread that also serves other links. A pulled cable therefore silenced hosts whose cables were
plugged in. And a link that was closed late, after the cable was back, was mistaken for its
successor, which was then closed instead on one side and never reopened.
"""

import contextlib
import ipaddress
import os
import socket
import stat
import struct

DESCRIPTORS = "/dev/fd"  # of this process
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
    # not the system's table of connections, which takes the longer the more hosts there are
    for name in os.listdir(DESCRIPTORS):
        with contextlib.suppress(OSError, ValueError):  # closed meanwhile, or no connection
            if _hastened(int(name), wanted):
                return True
    return False


def _hastened(number: int, wanted: tuple[End, End]) -> bool:
    """Set the options of a descriptor if it is the wanted connection."""
    if not stat.S_ISSOCK(os.fstat(number).st_mode):
        return False
    borrowed = socket.socket(fileno=number)
    try:
        if borrowed.family not in (socket.AF_INET, socket.AF_INET6):
            return False
        own, other = borrowed.getsockname()[:2], borrowed.getpeername()[:2]
        if (_plain(*own), _plain(*other)) != wanted:
            return False
        borrowed.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
        borrowed.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_MS)
        return True
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
