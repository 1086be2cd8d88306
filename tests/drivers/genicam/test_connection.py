"""A lost device is opened again, or its reader learns why not."""

import time
from collections.abc import Callable

import pytest

from drivers.genicam.connection import Connection
from pipeline.errors import DriverError


class Device:
    """Something that is open."""

    def close(self) -> None: ...


def once_then(again: Callable[[], Device]) -> Callable[[], Device]:
    """Open a device the first time, and do something else each further time."""
    attempts: list[int] = []

    def make() -> Device:
        attempts.append(1)
        return Device() if len(attempts) == 1 else again()

    return make


def broken() -> Device:
    raise RecursionError("too deep")


def test_a_lost_device_comes_back() -> None:
    connection = Connection("camera", once_then(Device), absent_s=10)
    first = connection.open()

    connection.lose("unplugged")

    assert connection.held(5) not in (None, first)
    connection.close()


def test_code_that_breaks_while_it_is_opened_again_is_an_error_for_the_reader() -> None:
    connection = Connection("camera", once_then(broken), absent_s=60)
    connection.open()
    connection.lose("unplugged")
    began_s = time.monotonic()

    with pytest.raises(DriverError, match="camera: opening it again broke: RecursionError: too"):
        connection.held(10)

    assert time.monotonic() - began_s < 5
    connection.close()
