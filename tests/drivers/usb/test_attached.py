"""The driver over a real kernel and a real libusb, on a board that is attached.

With `--usb-board=attached` (the default) it is the board on the desk; with `--usb-board=usbip` or
`gadget` it is a virtual one that the test attaches to this kernel, which takes root and the modules
vhci_hcd or dummy_hcd and usb_f_fs: see `make test-guest`.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.usb import DualStreamBoard, DualStreamBoardSettings
from drivers.usb.board_settings import configuration
from drivers.usb.connection import Connection
from drivers.usb.errors import Stalled
from tests.drivers.contract import check_sensor, memory, read, started
from tests.drivers.usb.attachments import VIRTUALLY, Gadgets, Usbip, attached_boards, until
from tests.drivers.usb.boards import VIRTUAL, played

pytestmark = pytest.mark.hardware

Attach = Callable[..., None]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test on every kind of board that `--usb-board` names."""
    kinds = metafunc.config.getoption("--usb-board") or ["attached"]
    metafunc.parametrize("kind_of_board", kinds, scope="module")


@pytest.fixture(scope="module")
def ports(request: pytest.FixtureRequest) -> Iterator[dict[str, Usbip | Gadgets]]:
    """Yield what attaches virtual boards, by the kind of board."""
    kinds = request.config.getoption("--usb-board")
    found = {kind: VIRTUALLY[kind]() for kind in kinds if kind in VIRTUALLY}
    yield found
    for one in found.values():
        one.close()


@pytest.fixture
def attach(kind_of_board: str, ports: dict[str, Usbip | Gadgets]) -> Iterator[Attach]:
    """Attach a virtual board where that is asked for; else the real one is there already."""
    with ExitStack() as boards:

        def attached_board(**settings: Any) -> None:
            if kind_of_board in ports:
                boards.enter_context(ports[kind_of_board].attached({**VIRTUAL, **settings}))
                until(lambda: attached_boards() == 1)
            elif settings:
                pytest.skip("a real board does not fail by script")

        yield attached_board
    if kind_of_board in ports:
        until(lambda: not attached_boards())


def board(**settings: Any) -> DualStreamBoard:
    return DualStreamBoard(DualStreamBoardSettings(**settings))


def test_it_keeps_the_contract_of_a_sensor(attach: Attach) -> None:
    attach()

    check_sensor(board)


def test_reads_one_after_the_other_deliver_the_same(attach: Attach) -> None:
    attach()
    seen = []
    for in_flight in (1, 16):
        subject = started(board(in_flight=in_flight))
        seen.append([read(subject) for _ in range(3)])
        subject.close()

    for one, other in zip(*seen, strict=True):
        assert one.header.seq == other.header.seq
        assert one.context.size_px == other.context.size_px
        assert one.roi.window == other.roi.window


def test_pictures_larger_than_a_bulk_read_arrive_whole(attach: Attach) -> None:
    attach(size_px=(1920, 1152))
    subject = started(board(payload_crc=True))
    exposures = [read(subject) for _ in range(3)]
    subject.close()

    assert not subject.summary()["losses"]
    assert len({e.context.pixels.tobytes() for e in exposures}) == 3


@pytest.mark.parametrize("stream", ["context", "roi"])
def test_frames_that_fail_are_lost_and_the_others_are_whole(attach: Attach, stream: str) -> None:
    kinds = ["stall", "truncate", "corrupt_header", "corrupt_payload", "overflow", "skip"]
    failing = {3 * (k + 1): kind for k, kind in enumerate(kinds)}
    attach(
        frames=20,
        faults=[{"kind": k, "exposure": at, "stream": stream} for at, k in failing.items()],
    )
    subject = board(payload_crc=True)

    exposures = played(subject)

    missing = {*range(20)} - {e.header.seq for e in exposures}
    # reads in flight may take the next header along
    assert set(failing) <= missing <= set(failing) | {at + 1 for at in failing}, subject.summary()


def test_an_unplugged_board_is_found_again(attach: Attach) -> None:
    attach(faults=({"kind": "unplug", "exposure": 5, "seconds": 0.5},))
    subject = started(board())

    exposures = [read(subject) for _ in range(10)]

    subject.close()
    assert [e.header.seq for e in exposures] == list(range(10))
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


def test_a_configuration_that_the_board_does_not_know_is_refused(attach: Attach) -> None:
    attach()
    connection = Connection(None, serial="", in_flight=1)
    wanted = configuration(DualStreamBoardSettings(), connection.can)

    with pytest.raises(Stalled):
        connection.configure(replace(wanted, roi_px=(2, 2)))

    assert connection.configure(wanted).roi_px == wanted.roi_px
    connection.close()
