"""The driver over a real kernel and a real libusb, on a board that is attached.

With `--usb-board=attached` (the default) it is the board on the desk; with `--usb-board=usbip` it
is a virtual one that the test attaches to this kernel, which takes root and the module vhci_hcd:
see `make test-guest`.
"""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from drivers.usb import DualStreamBoard, DualStreamBoardSettings
from drivers.usb.link import attached
from drivers.virtual_board import VirtualBackend, VirtualBoardSettings
from drivers.virtual_board.usbip import detach, serve
from tests.drivers.contract import check_sensor, memory, read, started
from tests.drivers.usb.boards import VIRTUAL, played

pytestmark = pytest.mark.hardware
PORT = 15  # the first SuperSpeed port of the virtual controller of a Debian kernel
FOUND_S = 20.0

Attach = Callable[..., None]


@pytest.fixture
def attach(request: pytest.FixtureRequest) -> Iterator[Attach]:
    """Attach a virtual board where that is asked for; else the real one is there already."""
    threads: list[threading.Thread] = []
    virtual = request.config.getoption("--usb-board") == "usbip"

    def attached_board(**settings: Any) -> None:
        if not virtual:
            if settings:
                pytest.skip("a real board does not fail by script")
            return
        backend = VirtualBackend(VirtualBoardSettings(**{**VIRTUAL, **settings}))
        thread = threading.Thread(target=serve, args=(backend.board,), kwargs={"port": PORT})
        threads.append(thread)
        thread.start()
        until(lambda: len(attached()) == 1)

    yield attached_board
    for thread in threads:
        detach(PORT)
        thread.join(FOUND_S)
        until(lambda: not attached())


def until(true: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + FOUND_S
    while not true():
        assert time.monotonic() < deadline_s, "the kernel did not notice"
        time.sleep(0.05)


def board(**settings: Any) -> DualStreamBoard:
    return DualStreamBoard(DualStreamBoardSettings(**settings))


@pytest.mark.parametrize("in_flight", [1, 16])
def test_it_keeps_the_contract_of_a_sensor(attach: Attach, in_flight: int) -> None:
    attach()

    check_sensor(lambda: board(in_flight=in_flight))


def test_pictures_larger_than_a_bulk_read_arrive_whole(attach: Attach) -> None:
    attach(size_px=(1920, 1152))
    subject = started(board(payload_crc=True))
    exposures = [read(subject) for _ in range(3)]
    subject.close()

    assert not subject.summary()["losses"]
    assert len({e.context.pixels.tobytes() for e in exposures}) == 3


@pytest.mark.parametrize("stream", ["context", "roi"])
@pytest.mark.parametrize(
    "kind", ["stall", "truncate", "corrupt_header", "corrupt_payload", "overflow", "skip"]
)
def test_a_frame_that_fails_is_lost_and_the_next_one_is_whole(
    attach: Attach, kind: str, stream: str
) -> None:
    attach(faults=({"kind": kind, "exposure": 20, "stream": stream},))
    subject = board(payload_crc=True)

    exposures = played(subject)

    seqs = [e.header.seq for e in exposures]
    missing = sorted({*range(40)} - {*seqs})
    assert 20 in missing
    assert len(missing) <= 2, subject.summary()  # reads in flight may take the next header along


def test_an_unplugged_board_is_found_again(attach: Attach) -> None:
    attach(faults=({"kind": "unplug", "exposure": 20, "seconds": 0.5},))
    subject = started(board())

    exposures = [read(subject) for _ in range(30)]

    subject.close()
    assert [e.header.seq for e in exposures] == list(range(30))
    assert subject.summary()["link"]["outages"] == 1
    assert len({e.header.stream for e in exposures}) == 1


def test_a_second_opener_is_refused_in_clear_words(attach: Attach) -> None:
    attach()
    first = started(board())

    with pytest.raises(Exception, match="in use by another process"):
        board().open(realtime=False)

    assert np.any(read(first).context.pixels)
    assert first.read(memory) is not None
    first.close()
