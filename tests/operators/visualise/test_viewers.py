"""Real viewers of one server: several at once, one that joins late, one that stands still."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from bench.watching import connected, viewer
from operators.visualise import Visualise, VisualiseSettings
from operators.visualise.server import SERVER_MEMORY, free_ports, viewers
from pipeline.run.supervisor import Supervisor
from tests.operators.visualise.exposures import exposure
from tests.operators.visualise.test_server import until
from tests.operators.visualise.test_visualise import layout_of, rows
from tests.sample_graphs import (
    CHAIN,
    assert_accounts_add_up,
    edge,
    go,
    handled,
    plan_of,
    together,
    wait_for,
)

FRAMES = range(12)
PICTURE = np.random.default_rng(0).bytes(1_000_000)
MOST_MB = int(SERVER_MEMORY.removesuffix("MB"))


@pytest.fixture
def served() -> Iterator[Visualise]:
    """A viewer's node that serves."""
    port, web_port = free_ports(2)
    subject = Visualise(VisualiseSettings(serve=True, port=port, web_port=web_port))
    subject.open()
    yield subject
    subject.close()


def watched_by(subject: Visualise, count: int) -> bool:
    """Return whether so many viewers come to watch."""
    return until(lambda: viewers(subject._screen._server.pid) == count)


def show(subject: Visualise, frames: range) -> float:
    """Show frames, each once the viewers take something; return the time in handlers, in s."""
    spent_s = 0.0
    for seq in frames:
        assert until(subject._screen.wanted)
        began_s = time.monotonic()
        for given in exposure(seq):
            ((name, message),) = given.items()
            getattr(subject, f"on_{name}")(message)
        spent_s += time.monotonic() - began_s
    assert until(subject._screen.takes)
    return spent_s


def holds(file: Path, count: int) -> bool:
    """Return whether so many large pictures are in a file."""
    return file.exists() and file.stat().st_size > count * len(PICTURE)


def shown_in(file: Path) -> set[object]:
    """Return the frames that a viewer was sent.

    On a busy machine one may be missing, as nothing is sent while it takes more than 20 ms.
    """
    return set(rows(list(RrdReader(file).stream()), "/sensor/tracks", "frame"))


def fill(subject: Visualise, count: int) -> None:
    """Send large pictures for as long as they are taken."""
    for _ in range(count):
        if subject._screen.takes():
            image = rr.EncodedImage(contents=PICTURE, media_type="image/jpeg")
            subject._screen._recording.log("filler", image)


def test_all_viewers_see_the_same_and_one_that_comes_late_has_layout_and_state(
    served: Visualise, tmp_path: Path
) -> None:
    port, files = served.settings.port, [tmp_path / f"{k}.rrd" for k in range(3)]
    with viewer(port, files[0]) as first, viewer(port, files[1]) as second:
        assert watched_by(served, 2)
        show(served, FRAMES)
        with viewer(port, files[2]) as late:
            assert watched_by(served, 3)
            fill(served, 1)  # what comes last; a server that ends drops what is on its way
            assert until(lambda: all(holds(file, 1) for file in files))
            served.close()
            assert [client.wait(20) for client in (first, second, late)] == [0, 0, 0]

    for file in files:
        assert shown_in(file) == shown_in(files[0])
        assert len(shown_in(file)) > len(FRAMES) / 2
        chunks = list(RrdReader(file).stream())
        assert len(rows(chunks, "/legend", "TextDocument:text")) == 1
        assert layout_of(file)["views"] >= {"whole field, the ROI in place", "full resolution"}


def test_a_viewer_that_stands_still_delays_neither_the_operator_nor_another_viewer(
    served: Visualise, tmp_path: Path
) -> None:
    port = served.settings.port
    with viewer(port, tmp_path / "a.rrd") as still, viewer(port, tmp_path / "b.rrd") as other:
        assert watched_by(served, 2)
        show(served, range(2))
        still.send_signal(signal.SIGSTOP)
        for _ in range(20):  # together more than the kernel holds for it
            assert until(served._screen.takes)
            fill(served, 1)
        spent_s = show(served, FRAMES)
        fill(served, 1)
        assert until(lambda: holds(tmp_path / "b.rrd", 21))
        served.close()
        assert other.wait(20) == 0

    assert len(shown_in(tmp_path / "b.rrd")) > len(FRAMES) / 2
    assert spent_s < 10  # if it waited for a viewer, it would for ever


@pytest.mark.slow
def test_the_memory_of_the_server_is_bounded_whoever_stands_still(
    served: Visualise, tmp_path: Path
) -> None:
    server = psutil.Process(served._screen._server.pid)
    with viewer(served.settings.port, tmp_path / "a.rrd") as still:
        assert watched_by(served, 1)
        show(served, range(2))
        still.send_signal(signal.SIGSTOP)
        for _ in range(12):
            fill(served, 100)
            time.sleep(0.2)

        assert server.memory_info().rss / 1e6 < 3 * MOST_MB  # of 1200 MB


WATCHED = """\
  viewer:
    operator: operators.visualise:Visualise
    inputs: {context: ticker.context, roi: ticker.roi}
    settings: {serve: true, port: PORT, web_port: WEB}
"""


def test_a_graph_goes_on_while_its_viewer_stands_still(tmp_path: Path) -> None:
    port, web_port = free_ports(2)
    text = together(CHAIN, "ticker", "count", "glance")
    text += WATCHED.replace("PORT", str(port)).replace("WEB", str(web_port))

    def freeze(supervisor: Supervisor) -> None:
        with viewer(port, tmp_path / "a.rrd") as client:
            watches = psutil.Process(client.pid)
            wait_for(supervisor, lambda: connected(watches, port))
            os.kill(client.pid, signal.SIGSTOP)
            before = handled(supervisor, "count")
            wait_for(supervisor, lambda: handled(supervisor, "count") > before + 30)
            supervisor.finish()

    report = go(plan_of(tmp_path, text), 0, freeze)

    assert_accounts_add_up(report)
    # seen on a busy machine, 3 pictures at 60 Hz; whether the viewer had a part in it is not known
    assert set(edge(report, "count.frame")["dropped"]) <= {"overrun"}
    assert report["restarts"] == {}
