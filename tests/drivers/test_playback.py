"""Playback: every picture at its time; late pictures do not shift the timetable."""

import os
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.simulated.pace import Pace
from drivers.simulated.playback import Playback, Timing
from drivers.simulated.prefetch import WORLD_NICENESS
from tests.drivers.moving_square import MovingSquare
from tests.sample_graphs import until


def play(source: MovingSquare, timing: Timing, *, reader_s: float = 0.0) -> list[tuple[int, int]]:
    """Play a source to its end; return seq and stamp of every picture that was read."""
    played = Playback(source, timing)
    found = []
    while (taken := played.take()) is not None:
        ready, stamp_ns = taken
        found.append((ready.seq, stamp_ns))
        time.sleep(reader_s)
        played.done(ready)
    played.close()
    skipped = found[-1][0] + 1 - len(found)
    assert played.skipped == skipped
    assert played.elapsed == found[-1][0] + 1
    return found


def assert_on_the_timetable(found: list[tuple[int, int]], rate_hz: float) -> None:
    """Assert that no picture comes before its time, also after late ones."""
    first_seq, first_ns = found[0]
    for seq, stamp_ns in found:
        assert stamp_ns - first_ns >= (seq - first_seq) * 1e9 / rate_hz


def test_realtime_keeps_the_rate_on_an_absolute_timetable() -> None:
    found = play(MovingSquare(length=30), Timing(rate_hz=100, realtime=True))

    assert_on_the_timetable(found, 100)


def test_lockstep_does_not_wait() -> None:
    began = time.monotonic()
    found = play(MovingSquare(length=100, rate_hz=0.01), Timing(rate_hz=0.01))

    assert [seq for seq, _ in found] == list(range(100))
    assert time.monotonic() - began < 100  # one period of a hundred


def test_a_slow_source_leaves_frames_out_and_keeps_time() -> None:
    found = play(MovingSquare(length=60, slow_s=0.025), Timing(rate_hz=100, realtime=True))

    assert len(found) < 30  # each takes two and a half periods
    assert_on_the_timetable(found, 100)


def test_a_slow_reader_leaves_frames_out_and_keeps_time() -> None:
    found = play(MovingSquare(length=60), Timing(rate_hz=100, realtime=True), reader_s=0.025)

    assert len(found) < 30
    assert_on_the_timetable(found, 100)


def test_the_next_picture_is_made_while_the_reader_waits_for_its_time() -> None:
    source = MovingSquare(length=10, rate_hz=0.01)
    played = Playback(source, Timing(rate_hz=0.01, realtime=True))
    first = played.take()
    assert first is not None
    played.done(first[0])
    reader = threading.Thread(target=played.take)
    reader.start()

    until(lambda: source.made == [0, 1])  # a hundred seconds early

    assert reader.is_alive()
    played.stop()
    reader.join()
    played.close()


def test_pictures_are_made_by_one_thread_of_their_own() -> None:
    source = MovingSquare(length=5)
    play(source, Timing(rate_hz=100))

    assert len(source.threads) == 1
    assert threading.get_ident() not in source.threads


@pytest.mark.parametrize("niceness", [0, 10])
def test_pictures_are_made_behind_the_graph_and_niceness_is_never_lowered(niceness: int) -> None:
    found: list[int] = []
    inherited = max(niceness, os.getpriority(os.PRIO_PROCESS, 0))

    class Watched(MovingSquare):
        def picture(self, index: int) -> NDArray[np.uint8]:
            found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
            return super().picture(index)

    def play_one() -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), inherited)
        play(Watched(length=1), Timing(rate_hz=100))

    player = threading.Thread(target=play_one, daemon=True)
    player.start()
    player.join(10)

    assert not player.is_alive()
    assert found == [max(inherited, WORLD_NICENESS)]


def test_a_slower_sensor_sees_every_second_frame_and_a_faster_one_sees_each_twice() -> None:
    def shown(rate_hz: float, reads: int) -> list[int]:
        source = MovingSquare(length=12, rate_hz=100)
        played = Playback(source, Timing(rate_hz=rate_hz))
        places = []
        for _ in range(reads):
            taken = played.take()
            assert taken is not None
            places.append(int(taken[0].truth.boxes[0, 0]) // 5)  # type: ignore[union-attr]
            played.done(taken[0])
        end = played.take() is None
        played.close()
        assert end
        return places

    assert shown(50, 6) == [0, 2, 4, 6, 8, 10]
    assert shown(200, 24) == sorted([*range(12), *range(12)])


@given(
    rate_hz=st.floats(0.1, 1000),
    interval=st.integers(1, 16),
    seq=st.integers(0, 10**6),
    behind_s=st.floats(-1, 100),
)
def test_the_following_exposure_is_the_first_that_is_not_due_yet(
    rate_hz: float, interval: int, seq: int, behind_s: float
) -> None:
    pace = Pace(rate_hz, interval)
    pace.begin(0, 1_000_000)
    seq *= interval
    now_ns = pace.due_ns(seq) + round(behind_s * 1e9)

    found = pace.following(seq, now_ns)

    assert (found - seq) % interval == 0
    assert found > seq
    assert pace.due_ns(found) >= now_ns
    assert found == seq + interval or pace.due_ns(found - interval) < now_ns + 2
