"""A connection does not outlive its cable."""

import socket
import struct

from pipeline.bus.network import LEASE_MS
from pipeline.bus.sockets import DEAD_MS, hasten


def lingers(end: socket.socket) -> bool:
    return struct.unpack("ii", end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0] != 0


def test_no_tcp_connection_lingers_or_waits_for_long_and_all_stay_open() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
        with near, far:
            near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
            assert lingers(near)

            assert hasten() >= 3

            assert not lingers(near)
            patience_ms = near.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
            assert patience_ms == DEAD_MS < LEASE_MS
            near.sendall(b"still there")
            assert far.recv(11) == b"still there"
