"""Lost frames are all counted; of each reason one a second is reported."""

import pytest

from drivers.usb import losses
from drivers.usb.losses import Losses


def test_losses_are_counted_and_one_a_second_of_each_reason_is_reported(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    monkeypatch.setattr(losses.time, "monotonic", lambda: now_s)
    found = Losses()

    for frame in range(5):
        found.lose("overflow", f"frame {frame} is too long")
    found.lose("dropped", "the board has dropped frames", 7)
    now_s = 1.0
    found.lose("overflow", "frame 9 is too long")

    assert found == {"overflow": 6, "dropped": 7}
    assert caplog.messages == [
        "frame 0 is too long",
        "the board has dropped frames",
        "frame 9 is too long (4 more before it)",
    ]
