"""Orders to a graph: how many may wait, and that one is taken up at a time."""

from types import SimpleNamespace
from typing import Any

from pipeline.protocol.codec import decode, encode
from pipeline.protocol.orders import RESULT, Refused, StopOrder, StopResult
from pipeline.run.control_server import MOST_ASKED, ControlServer


def test_orders_beyond_what_may_wait_are_refused_and_one_is_taken_up_a_tick() -> None:
    woken: list[int] = []
    manager: Any = SimpleNamespace(
        exchange=SimpleNamespace(wake=lambda: woken.append(1)),
        plan=SimpleNamespace(name="g", here=""), stop_orders=0,
    )  # fmt: skip
    server = ControlServer(manager, SimpleNamespace())  # type: ignore[arg-type]
    answers: list[bytes] = []

    for _ in range(MOST_ASKED + 30):
        server.ask(encode(StopOrder()), answers.append)

    refusals = [decode(RESULT, answer) for answer in answers]
    assert refusals == [Refused(f"g: {MOST_ASKED} orders are waiting", busy=True)] * 30
    for count in range(1, MOST_ASKED + 1):
        woken.clear()
        server.tick()
        assert manager.stop_orders == count
        assert len(woken) == (count < MOST_ASKED)  # for the ones that still wait
    assert all(isinstance(decode(RESULT, answer), StopResult) for answer in answers[30:])
