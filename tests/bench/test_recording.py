"""What a recorder takes is counted, and files of killed recorders are read."""

import pytest

from bench.recording import SMALL_PX, after_kills, pictures, recorded


def test_small_streams_are_recorded_whole() -> None:
    shown = pictures(SMALL_PX, "bayer_rggb8", 1)

    row = recorded(shown, "bayer_rggb8", "lz4", 0.5)

    assert (row["exposures"], row["recorded"], row["dropped, share"]) == (15, 15, 0)
    assert (row["MB/s offered"], row["failure"]) == (8, "none")
    assert 0 < row["size"] < 1.1


@pytest.mark.lengthy
def test_the_file_of_a_killed_recorder_ends_before_the_kill() -> None:
    killed = after_kills(1, 1)

    assert (killed["kills"], killed["unreadable"]) == (1, 0)
    assert killed["s before the kill"]["median"] > 0
