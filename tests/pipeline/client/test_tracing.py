"""A trace that cannot be begun leaves nothing open."""

from typing import Any

import pytest

from pipeline import RunError
from pipeline.client.tracing import Tracing


class Listener:
    """A tap of which one is on a host that is gone."""

    def __init__(self, output: str) -> None:
        self.output, self.opened = output, False

    def __enter__(self) -> "Listener":
        if self.output == "gone":
            raise RunError("gone: no such host")
        self.opened = True
        return self

    def __exit__(self, *_: object) -> None:
        self.opened = False


class Client:
    def __init__(self) -> None:
        self.listeners = {output: Listener(output) for output in ("eye", "gone")}

    def listen(self, output: str) -> Listener:
        return self.listeners[output]


def test_taps_are_closed_when_the_next_one_cannot_be_opened() -> None:
    client: Any = Client()

    with (
        pytest.raises(RunError, match="no such host"),
        Tracing(client, {"eye": (), "gone": ()}, lambda _spans: None),
    ):
        pass

    assert not client.listeners["eye"].opened
