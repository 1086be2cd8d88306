"""Links to other hosts that give up a cable that was pulled, at once and altogether.

Zenoh offers no setting for either: what it sends waits for a dead connection for as long as the
kernel tries (minutes), and closing one waits until everything was acknowledged (SO_LINGER, ten
seconds), on a thread that serves its other links too. So a pulled cable silenced boxes whose cables
were in; and a link that was closed late, when the cable was in again, was taken for its successor,
which was then closed in its place on one side and never opened again.
"""

import os
import socket
import struct
from pathlib import Path

DEAD_MS = 1500  # without an acknowledgement; less than the lease that Zenoh has with a peer
_AT_ONCE = struct.pack("ii", 0, 0)
_OPEN = Path("/proc/self/fd")


def hasten() -> int:
    """Let no TCP connection of this process outlive its cable; how many sockets are there."""
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
            borrowed.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
            borrowed.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_MS)
            return True
        return False
    finally:
        borrowed.detach()  # it stays its owner's
