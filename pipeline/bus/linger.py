"""Closes links to other hosts without waiting for them.

Zenoh has the kernel hold up the closing of a TLS link until everything sent was acknowledged, for
up to ten seconds (SO_LINGER, a constant in it), on a thread that serves its other links too. A
pulled cable so silenced boxes whose cables were in, and a link that was closed late took the
subscriptions of its successor along.
"""

import os
import socket
import struct
from pathlib import Path

_OFF = struct.pack("ii", 0, 0)
_OPEN = Path("/proc/self/fd")


def hasten() -> int:
    """Let no TCP socket of this process linger; how many are there."""
    found = 0
    for name in os.listdir(_OPEN):
        try:
            if os.readlink(_OPEN / name).startswith("socket:"):
                found += _hasten(int(name))
        except OSError:
            continue  # closed meanwhile
    return found


def _hasten(number: int) -> bool:
    borrowed = socket.socket(fileno=number)
    try:
        internet = borrowed.family in (socket.AF_INET, socket.AF_INET6)
        if internet and borrowed.type == socket.SOCK_STREAM:
            borrowed.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            return True
        return False
    finally:
        borrowed.detach()  # it stays its owner's
