"""A link that delays, loses, stalls or breaks affects only its remote reader, never the writer."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.bus.session import Sender, Session
from tests.pipeline.run.bad_link import BadLink
from tests.sample_graphs import until

PICTURE = bytes(1_000_000)


class Far:
    """A reader behind a bad link, and its writer."""

    def __init__(self, folder: Path) -> None:
        for name in ("here", "there"):
            (folder / name).mkdir()
        self.writer = Session(folder / "here", "hub")
        self.link = BadLink(folder / "there" / "hub.sock", folder / "here" / "hub.sock")
        self.reader = Session(folder / "there", "far")
        self.heard: list[tuple[int, float]] = []  # number, when
        self.reader.listen("fovea/far/frame", self._hear)
        self.sender: Sender = self.writer.sender("fovea/far/frame")
        self.sent = 0
        until(lambda: self.sender.matching())

    def send(self, body: bytes = b"") -> int:
        """Send the next message; return how many were sent."""
        self.sender.send(self.sent.to_bytes(4, "little") + body)
        self.sent += 1
        return self.sent

    def close(self) -> None:
        self.link.stalled.clear()
        self.reader.close()
        self.writer.close()
        self.link.__exit__()

    def _hear(self, payload: bytes) -> None:
        self.heard.append((int.from_bytes(payload[:4], "little"), time.monotonic()))


@pytest.fixture
def far(short_path: Path) -> Iterator[Far]:
    made = Far(short_path)
    yield made
    made.close()


def test_a_link_that_delays_and_loses_keeps_the_order(far: Far) -> None:
    far.link.delay_s, far.link.loss = 0.15, 0.2

    sent_s = []
    for _ in range(30):
        sent_s.append(time.monotonic())
        far.send()
        time.sleep(0.01)
    until(lambda: len(far.heard) == 30)

    assert [number for number, _ in far.heard] == list(range(30))
    assert min(at_s - sent_s[number] for number, at_s in far.heard) >= 0.15


def test_a_stalled_link_never_makes_the_writer_wait_and_drops_old_messages(far: Far) -> None:
    far.send()
    until(lambda: len(far.heard) == 1)
    far.link.stalled.set()

    for _ in range(150):
        far.send(PICTURE)
    assert far.link.links == 1  # a writer that waits does so until the link ends
    far.link.stalled.clear()
    until(lambda: far.send() > 0 and far.heard[-1][0] > 150)

    pictures = [number for number, _ in far.heard if 1 <= number <= 150]
    assert len(pictures) < 100  # what did not fit into the queues of the link was dropped


def test_a_link_that_breaks_comes_back_by_itself(far: Far) -> None:
    far.send()
    until(lambda: len(far.heard) == 1)

    far.link.cut()
    until(lambda: not far.sender.matching())
    lost = far.sent
    far.send()
    far.link.mend()
    until(far.sender.matching)
    far.send()
    until(lambda: far.heard[-1][0] == far.sent - 1)

    assert lost not in [number for number, _ in far.heard]
    assert far.link.links >= 2


def test_a_near_reader_receives_everything_while_another_link_stalls(
    far: Far, short_path: Path
) -> None:
    near = Session(short_path / "here", "near")
    heard: list[int] = []
    near.listen(
        "fovea/far/frame", lambda payload: heard.append(int.from_bytes(payload[:4], "little"))
    )
    until(lambda: far.send() > 0 and bool(heard))
    until(lambda: heard[-1] == far.sent - 1)
    far.link.stalled.set()

    for _ in range(60):
        far.send(PICTURE)
        until(lambda: heard[-1] == far.sent - 1)

    assert heard == list(range(heard[0], far.sent))
    near.close()
