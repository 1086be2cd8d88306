"""Rerun's server: on the loopback only, ended with the operator, and never in its way."""

import socket
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import psutil
import pytest
import rerun as rr

from operators.visualise import Visualise, VisualiseSettings
from pipeline import RunError
from pipeline.testing import drive
from tests.operators.visualise.exposures import part

VIEWER = """
import socket, sys
with socket.create_connection(("127.0.0.1", int(sys.argv[1]))):
    sys.stdin.read()
"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_the_server_listens_on_the_loopback_only_and_ends_with_the_operator(tmp_path):
    subject = Visualise(VisualiseSettings(serve=True, port=free_port(), web_port=free_port()))

    subject.open()
    server = psutil.Process(subject._screen._server.pid)
    listening = {c.laddr.ip for c in server.net_connections() if c.status == "LISTEN"}
    subject.on_context(part(0, "context"))
    subject.close()

    assert listening == {"127.0.0.1"}
    assert not server.is_running()


def test_nothing_is_encoded_while_nobody_watches(tmp_path):
    port = free_port()
    subject = Visualise(VisualiseSettings(serve=True, port=port, web_port=free_port()))
    subject.open()

    unwatched = subject._screen.wanted()
    viewer = subprocess.Popen([sys.executable, "-c", VIEWER, str(port)], stdin=subprocess.PIPE)
    watched = until(subject._screen.wanted)
    viewer.communicate()
    left = until(lambda: not subject._screen.wanted())
    subject.close()

    assert (unwatched, watched, left) == (False, True, True)


def test_a_stalled_server_neither_delays_the_operator_nor_gathers_frames(tmp_path):
    subject = Visualise(VisualiseSettings(serve=True, port=free_port(), web_port=free_port()))
    subject.open()
    screen = subject._screen
    server = psutil.Process(screen._server.pid)
    subject.on_context(part(0, "context"))

    server.suspend()
    filler = np.random.default_rng(0).bytes(200_000)  # more than kernel and channel hold
    for _ in range(60):
        screen._recording.log("filler", rr.EncodedImage(contents=filler, media_type="image/jpeg"))
    stalled = until(lambda: not screen.takes())
    began_s = time.monotonic()
    for seq in range(1, 50):
        subject.on_context(part(seq, "context"))
    took_s = time.monotonic() - began_s
    held = len(screen._held._items)
    server.resume()
    again = until(screen.takes)
    subject.close()

    assert (stalled, again, held) == (True, True, 0)
    assert took_s < 1


def until(true: Callable[[], bool], timeout_s: float = 10.0) -> bool:
    """Return whether it comes true in that time."""
    late_s = time.monotonic() + timeout_s
    while not (found := true()) and time.monotonic() < late_s:
        time.sleep(0.05)
    return found


def test_a_port_that_is_taken_is_named():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]

        with pytest.raises(RunError, match=f"expected port {port} to be free"):
            drive(Visualise, [], {"serve": True, "port": port})
