"""`hasten` makes a TCP connection end soon after its cable was unplugged."""

import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pipeline.bus.network import LEASE_MS
from pipeline.bus.sockets import DEAD_MS, hasten


@contextmanager
def connection(host: str) -> Iterator[tuple[socket.socket, socket.socket]]:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, 0), family=family).close()
    except OSError as error:
        pytest.skip(f"this host has no {host}: {error}")
    with socket.create_server((host, 0), family=family) as server:
        near = socket.create_connection(server.getsockname()[:2])
        far, _ = server.accept()
        with near, far:
            near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
            yield near, far


def manners(end: socket.socket) -> tuple[bool, int]:
    lingers = struct.unpack("ii", end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0]
    return bool(lingers), end.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)


def locator(name: tuple[str, int]) -> str:
    host, port = name[:2]
    return f"tls/[{host}]:{port}" if ":" in host else f"tls/{host}:{port}"


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_the_named_connection_neither_lingers_nor_waits_for_long_and_stays_open(host: str) -> None:
    with connection(host) as (near, far), connection(host) as (foreign, _):
        before = foreign.getblocking()

        assert hasten(locator(near.getsockname()), locator(near.getpeername()))

        assert manners(near) == (False, DEAD_MS)
        assert DEAD_MS < LEASE_MS
        assert manners(foreign) == (True, 0)
        assert foreign.getblocking() is before
        near.sendall(b"still there")
        assert far.recv(11) == b"still there"


def test_hasten_returns_false_for_a_connection_that_is_gone() -> None:
    assert not hasten("tls/127.0.0.1:1", "tls/127.0.0.1:2")


@pytest.mark.parametrize("far", ["/tmp/agent-viewer.sock", "c52b79a8-339c-43f5-bfe5-21cd410e350c"])
def test_unix_sockets_are_left_alone(far: str) -> None:
    assert not hasten("unixsock-stream//tmp/agent-desk.sock", f"unixsock-stream/{far}")
