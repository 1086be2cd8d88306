"""An order also receives events of a process that has already ended."""

from types import SimpleNamespace
from typing import cast

import pytest

from pipeline.protocol.orders import Refused, StopResult
from pipeline.protocol.supervision import Event, Failed, Fits
from pipeline.run.operation import Operation
from pipeline.run.process_handle import ProcessHandle
from tests.sample_graphs import reasons

ENDED = cast(ProcessHandle, SimpleNamespace(name="work", pid=7, ended=lambda: 0, bury=bool))


class Checked(Operation):
    """Waits for the event `Fits` of a trial."""

    def advance(self) -> bool:
        fits = self.events.heard(ENDED, Fits) is not None
        if not fits:
            self.events.check_alive(ENDED)
        return fits

    def done(self) -> StopResult:
        return StopResult(graph="g", pid=1)


@pytest.mark.parametrize(
    ("word", "refused"), [(Fits(), ""), (Failed("it does not fit", True), "it does not fit")]
)
def test_the_last_event_of_an_ended_process_counts(word: Event, refused: str) -> None:
    order = Checked()
    order.tick()
    assert order.result is None

    order.on_event(ENDED.pid, word)
    order.tick()

    assert order.result is not None
    assert reasons([order.result]) == [refused]


def test_a_process_that_ends_without_an_event_has_failed() -> None:
    order = Checked()

    order.tick()
    order.tick()

    assert order.result == Refused("work: it ended by exit status 0")


def test_an_order_that_breaks_is_refused_and_cleared_up() -> None:
    cleared: list[bool] = []

    class Broken(Checked):
        def advance(self) -> bool:
            raise ZeroDivisionError("by design")

        def clear_up(self, *, failed: bool) -> None:
            cleared.append(failed)

    order = Broken()
    order.tick()

    assert order.result == Refused("it failed: ZeroDivisionError: by design")
    assert cleared == [True]
