"""Start Rerun's server for browsers, and check for listeners at an address."""

import socket
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from subprocess import DEVNULL, Popen
from urllib.parse import urlsplit

import psutil

from pipeline.errors import RunError

# an operator killed outright cannot end its server: the kernel does (1: PR_SET_PDEATHSIG)
DIE_WITH_PARENT = (
    "import ctypes, os, signal, sys; ctypes.CDLL(None).prctl(1, signal.SIGTERM);"
    "os.execv(sys.argv[1], sys.argv[1:])"
)
START_S = 10.0  # to wait for a viewer or a server to listen
SERVER_MEMORY = "256MB"  # what a late viewer can look back on
LOOK_S = 0.5  # between two looks at who watches; a look takes 15 ms
FLUSH_S = 0.02  # for what was sent to arrive; a viewer that takes it needs less than 1 ms


def serve(port: int, web_port: int, *files: Path) -> Popen[bytes]:
    """Start Rerun's server for browsers on this machine only; it ends when this process does.

    It shows what is sent to it, and recordings.

    The SDK's own `serve_grpc` listens on every interface of the machine; its command does not.
    Raises `RunError` when Rerun's program is missing, or a port is taken.
    """
    binary = program()
    for wanted in (port, web_port):
        check_free(wanted)
    ports = ["--port", str(port), "--web-viewer-port", str(web_port)]
    options = ["--serve-web", "--bind", "127.0.0.1", "--server-memory-limit", SERVER_MEMORY]
    return Popen(
        [sys.executable, "-c", DIE_WITH_PARENT, str(binary), *map(str, files), *ports, *options],
        stdin=DEVNULL,
        stdout=DEVNULL,
        stderr=DEVNULL,
    )


def program() -> Path:
    """Return Rerun's program; raises `RunError` when it is missing."""
    found = find_spec("rerun_cli")
    binary = Path(found.origin).with_name("rerun") if found and found.origin else Path("rerun")
    if not binary.is_file():
        raise RunError(f"visualise.serve: expected Rerun's program at {binary}, got none")
    return binary


def check_free(port: int) -> None:
    """Raise `RunError` when somebody has this port of the loopback already."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise RunError(f"visualise.serve: expected port {port} to be free: {error}") from error


def free_ports(count: int) -> list[int]:
    """Return so many ports of the loopback that nobody has now."""
    with ExitStack() as probes:
        taken = [probes.enter_context(socket.socket()) for _ in range(count)]
        for probe in taken:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in taken]


def await_listener(url: str) -> None:
    """Wait until somebody listens at `url`; raises `RunError` after `START_S`.

    Rerun itself would take messages for a viewer that never comes, until its queue is full.
    """
    address = urlsplit(url.removeprefix("rerun+"))
    if not (address.hostname and address.port):
        raise RunError(f"visualise.connect: expected rerun+http://HOST:PORT/proxy, got {url}")
    deadline = time.monotonic() + START_S
    while True:
        try:
            socket.create_connection((address.hostname, address.port), timeout=1).close()
        except OSError as error:
            if time.monotonic() > deadline:
                raise RunError(f"visualise: expected a viewer at {url}, got {error}") from error
            time.sleep(0.05)
        else:
            return


class Audience:
    """Whether somebody looks, and takes what is sent: looked at every `LOOK_S`.

    While a viewer that was connected to does not take what it was sent, nothing more is queued
    for it: the memory of a stalled viewer is what came in one `LOOK_S`.
    """

    def __init__(self, server: Popen[bytes] | None, flush: Callable[[float], bool]) -> None:
        """`server`: Rerun's, if this process started it; without it there is one viewer."""
        self._server, self._flush = server, flush
        self._looked_s = -LOOK_S
        self.watches = self.takes = True

    def look(self) -> None:
        """Bring `watches` and `takes` up to date."""
        if time.monotonic() - self._looked_s < LOOK_S:
            return
        self.takes = self._flush(FLUSH_S)
        self.watches = self._server is None or viewers(self._server.pid) > 0
        self._looked_s = time.monotonic()


def viewers(server_pid: int) -> int:
    """Return how many viewers fetch data from Rerun's server; 0 when it has ended.

    A browser that has loaded the page and not yet connected to the data is none.
    """
    try:
        links = psutil.Process(server_pid).net_connections("tcp")
        own = {link.laddr.port for link in psutil.Process().net_connections("tcp")}
    except psutil.Error:
        return 0
    open_ = [link for link in links if link.status == psutil.CONN_ESTABLISHED]
    data_port = {link.laddr.port for link in open_ if link.raddr.port in own}
    return sum(link.laddr.port in data_port and link.raddr.port not in own for link in open_)
