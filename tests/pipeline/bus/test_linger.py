"""A socket's closing is waited for by nobody."""

import socket
import struct

from pipeline.bus.linger import hasten


def lingers(end: socket.socket) -> bool:
    return struct.unpack("ii", end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0] != 0


def test_no_tcp_socket_lingers_and_all_stay_open() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
        with near, far:
            near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
            assert lingers(near)

            assert hasten() >= 3

            assert not lingers(near)
            near.sendall(b"still there")
            assert far.recv(11) == b"still there"
