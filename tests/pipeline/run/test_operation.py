"""What an order waits for may be said by a process that has ended already."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pipeline.protocol.orders import Refused, StopResult
from pipeline.run.operation import Operation
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.process_manager import ProcessManager
from tests.sample_graphs import reasons

ENDED = cast(ProcessHandle, SimpleNamespace(name="work", pid=7, ended=lambda: 0, bury=bool))


class Checked(Operation):
    """Waits for a trial to say that it fits."""

    def __init__(self) -> None:
        super().__init__(cast(ProcessManager, None), self._steps_of_it())

    def done(self) -> StopResult:
        return StopResult(graph="g", pid=1)

    def _steps_of_it(self) -> Iterator[None]:
        yield from self.until(lambda: "fits" in self.heard(ENDED), 60, "no answer", of=ENDED)


@pytest.mark.parametrize(
    ("word", "refused"),
    [
        ({"event": "fits"}, ""),
        ({"event": "failed", "error": "it does not fit"}, "it does not fit"),
    ],
)
def test_its_last_words_count(word: dict[str, Any], refused: str) -> None:
    order = Checked()
    order.tick()
    assert order.result is None

    order.on_event(ENDED.pid, word)
    order.tick()

    assert isinstance(order.result, Refused if refused else StopResult)
    assert reasons([order.result]) == [refused]


def test_who_ends_without_a_word_has_failed() -> None:
    order = Checked()

    order.tick()
    order.tick()

    assert order.result == Refused("work: it ended by exit status 0")
