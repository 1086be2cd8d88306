"""Start Rerun's server for browsers, and check for listeners at an address."""

import socket
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from subprocess import DEVNULL, Popen
from urllib.parse import urlsplit

from pipeline.errors import RunError

# an operator killed outright cannot end its server: the kernel does (1: PR_SET_PDEATHSIG)
DIE_WITH_PARENT = (
    "import ctypes, os, signal, sys; ctypes.CDLL(None).prctl(1, signal.SIGTERM);"
    "os.execv(sys.argv[1], sys.argv[1:])"
)
START_S = 10.0  # to wait for a viewer or a server to listen
SERVER_MEMORY = "256MB"  # what a late viewer can look back on


def serve(port: int, web_port: int) -> Popen[bytes]:
    """Start Rerun's server for browsers on this machine only; it ends when this process does.

    The SDK's own `serve_grpc` listens on every interface of the machine; its command does not.
    Raises `RunError` when Rerun's program is missing, or a port is taken.
    """
    found = find_spec("rerun_cli")
    binary = Path(found.origin).with_name("rerun") if found and found.origin else Path("rerun")
    if not binary.is_file():
        raise RunError(f"visualise.serve: expected Rerun's program at {binary}, got none")
    for wanted in (port, web_port):
        check_free(wanted)
    ports = ["--port", str(port), "--web-viewer-port", str(web_port)]
    options = ["--serve-web", "--bind", "127.0.0.1", "--server-memory-limit", SERVER_MEMORY]
    return Popen(
        [sys.executable, "-c", DIE_WITH_PARENT, str(binary), *ports, *options],
        stdin=DEVNULL,
        stdout=DEVNULL,
        stderr=DEVNULL,
    )


def check_free(port: int) -> None:
    """Raise `RunError` when somebody has this port of the loopback already."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise RunError(f"visualise.serve: expected port {port} to be free: {error}") from error


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
