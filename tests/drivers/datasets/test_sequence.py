"""The setting `frames` of folders of numbered pictures."""

import pytest

from drivers.datasets.sequence import span
from pipeline.errors import SettingsError


@pytest.mark.parametrize("text", ["", "5-2", "0-3", "0", "-3", "3-", "1-2-3", "a-b", "1.5"])
def test_frames_that_no_sequence_can_have_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="frames: expected A-B, counted from 1, got"):
        span(text)
