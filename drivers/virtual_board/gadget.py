"""A virtual board as a USB gadget: this machine is the board, a host at its USB port reads from it.

    python -m drivers.virtual_board.gadget --scene soccer     (as root, on a port that is a device)

The kernel answers what every device is asked (ConfigFS describes it), this program the requests of
the protocol and both streams, through the files of FunctionFS.
"""

import logging
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

import click

from drivers.usb.frame_header import Stream
from drivers.usb.requests import Request
from drivers.virtual_board.backend import VirtualBackend
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.command_line import board_options, board_settings
from drivers.virtual_board.descriptors import STRINGS
from drivers.virtual_board.end_point import WAKE, EndPoint, StreamWriter
from drivers.virtual_board.errors import Gone, Refused
from drivers.virtual_board.function_fs import EventKind, FunctionFs
from drivers.virtual_board.gadget_configuration import GadgetConfiguration, controller_of
from drivers.virtual_board.setup_packet import INTERFACE, SetupPacket
from pipeline.errors import DriverError, FoveaError

NAME = "fovea"
POLL_S = 0.02  # how soon a board that was unplugged is plugged in again
EVENT_S = 1.0  # of a wait for an event; a stream that ends wakes it

log = logging.getLogger(__name__)


def serve(
    board: VirtualBoard, *, controller: str = "", name: str = NAME, serial: str = STRINGS[2]
) -> NoReturn:
    """Be that board until SIGTERM or SIGINT comes; raises `DriverError`.

    Runs in the main thread, since it sets handlers of signals. All that it makes is removed.
    """
    with _signals() as ignore, ExitStack() as made:
        try:
            controller = controller_of(controller)
            configuration = GadgetConfiguration(name)
            made.callback(configuration.close)
            configuration.make(serial)
            function = FunctionFs(name)
            made.callback(function.close)
            writers: list[StreamWriter] = []
            for stream, path in zip(Stream, function.open(), strict=True):
                writers.append(StreamWriter(board, stream, EndPoint(path), function.wake))
                made.callback(writers[-1].close)
            made.callback(configuration.unbind)  # this ends what waits for the host,
            made.callback(board.close)  # and this what waits for the board
            gadget = Gadget(board, function, writers)
            while True:
                configuration.bind(controller)
                log.info("gadget: plugged in at %s", controller)
                gadget.serve()
                configuration.unbind()
                log.info("gadget: unplugged by script")
                gadget.wait_until_plugged_in()
        finally:
            ignore()  # a second signal would leave something behind


class Gadget:
    """Answers the host; `serve` returns when the board has unplugged itself."""

    def __init__(
        self, board: VirtualBoard, function: FunctionFs, writers: list[StreamWriter]
    ) -> None:
        self._board, self._function, self._writers = board, function, writers

    def serve(self) -> None:
        """Answer requests; raises `DriverError` when an end point fails."""
        with suppress(Gone):
            while not any(writer.gone for writer in self._writers):
                self._step(EVENT_S)
                for failure in filter(None, (writer.failure for writer in self._writers)):
                    raise DriverError(f"gadget: a stream fails: {failure}")
        self._park()

    def wait_until_plugged_in(self) -> None:
        """Wait for a board that was unplugged by script."""
        while not self._board.present or self._function.event(0):
            time.sleep(POLL_S)

    def _step(self, timeout_s: float) -> None:
        event = self._function.event(timeout_s)
        if event is None:
            return
        if event.kind is EventKind.SETUP:
            self._control(event.setup)
        elif event.kind in (EventKind.ENABLE, EventKind.DISABLE, EventKind.UNBIND):
            # the kernel drops DISABLE when ENABLE follows: both begin anew
            log.info("gadget: the host's side: %s", event.kind.name.lower())
            self._board.reset()
            self._park()

    def _control(self, setup: SetupPacket) -> None:
        if not setup.vendor or setup.recipient != INTERFACE:
            self._function.refuse(setup)
            return
        try:
            if setup.reads:
                self._function.answer(self._board.ask(setup.request, setup.length))
            else:
                self._told(setup)
        except Refused as refusal:
            log.info("gadget: refused: %s", refusal)
            # data that have come were acknowledged with their coming, which is not undone
            if setup.reads or not setup.length:
                self._function.refuse(setup)

    def _told(self, setup: SetupPacket) -> None:
        data = self._function.take(setup.length) if setup.length else b""
        if data is None:
            return
        if setup.request in (Request.START, Request.STOP):
            self._board.tell(Request.STOP, 0, b"")
            self._park()
        self._board.tell(setup.request, setup.value, data)
        if setup.request == Request.START:
            for writer in self._writers:
                writer.go()
        if not setup.length:
            self._function.take(0)

    def _park(self) -> None:
        for writer in self._writers:
            writer.park()


@contextmanager
def _signals() -> Iterator[Callable[[], None]]:
    """Let SIGTERM and SIGINT end the program, and `WAKE` interrupt a write.

    Yields a function that makes SIGTERM and SIGINT do nothing any more.
    """
    ends = (signal.SIGTERM, signal.SIGINT)

    def ignore() -> None:
        for number in ends:
            signal.signal(number, signal.SIG_IGN)

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        ignore()
        raise SystemExit(0)

    before = {number: signal.getsignal(number) for number in (*ends, WAKE)}
    signal.signal(WAKE, lambda _number, _frame: None)
    for number in ends:
        signal.signal(number, end)
    try:
        yield ignore
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@click.command()
@board_options
@click.option("--serial", default=STRINGS[2], show_default=True, help="Serial number.")
@click.option("--udc", default="", help="USB device controller, where there are several.")
@click.option("--name", default=NAME, show_default=True, help="Of the gadget in ConfigFS.")
def main(serial: str, udc: str, name: str, **options: Any) -> None:
    """Make this machine a virtual board at its USB device port until it is ended."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        board = VirtualBackend(board_settings(**options)).board
        serve(board, controller=udc, name=name, serial=serial)
    except FoveaError as error:
        raise click.ClickException(str(error)) from None
    except OSError as error:
        raise click.ClickException(f"gadget: {error}") from None


if __name__ == "__main__":
    main()
