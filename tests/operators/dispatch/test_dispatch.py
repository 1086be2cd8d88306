"""Dispatch: predicted boxes become windows; a setting is the rule for frames without a box."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from operators.dispatch import Dispatch, DispatchSettings, coverage, plan_windows
from pipeline.errors import SettingsError
from pipeline.messages import Geometry, RoiSchedule, Scanpath
from pipeline.testing import drive, header
from tests.drivers.contract import assert_addressable

GRID = Geometry(width_px=320, height_px=192, roi_width_px=80, roi_height_px=48, step_px=4)
CENTRE = [120, 72, 200, 120]
NONE = [0.0, 0.0, 0.0, 0.0]


def scanpath(seq: int, boxes: Sequence[Sequence[float]], *, stream: str = "test") -> Scanpath:
    return Scanpath(
        header=header(seq, stream=stream, geometry=GRID),
        ids=np.array([7], np.int32),
        probability=np.ones((len(boxes), 1), np.float32),
        choice=np.full(len(boxes), 7, np.int32),
        boxes=np.array(boxes, np.float32).reshape(-1, 4),
        first_seq=seq + 1,
    )


def answers(paths: list[Scanpath], **settings: Any) -> list[RoiSchedule | None]:
    return drive(Dispatch, paths, settings)


def test_each_row_becomes_a_window_around_its_box() -> None:
    path = scanpath(4, [[98, 58, 102, 62], [158, 94, 162, 98]])
    (got,) = answers([path])

    assert got is not None
    assert got.windows.tolist() == [[60, 36, 140, 84], [120, 72, 200, 120]]
    assert got.windows.dtype == np.int32
    assert (got.first_seq, got.scanpath_seq, got.header) == (5, 4, path.header)


def test_a_scanpath_without_boxes_sends_no_schedule() -> None:
    assert answers([scanpath(0, [])]) == [None]


def test_a_new_plan_waits_until_the_interval_has_passed() -> None:
    paths = [scanpath(seq, [[0, 0, 9, 9]] * 16) for seq in range(17)]

    got = answers(paths, replan_every=8)

    assert [k for k, a in enumerate(got) if a is not None] == [0, 8, 16]


def test_gaps_in_the_frame_numbers_count_as_time() -> None:
    paths = [scanpath(seq, [[0, 0, 9, 9]] * 16) for seq in (0, 5, 11, 12, 30)]

    got = answers(paths, replan_every=8)

    assert [a is not None for a in got] == [True, False, True, False, True]


def test_a_plan_waits_until_frames_have_come_for_long_enough() -> None:
    paths = [scanpath(seq, [[0, 0, 9, 9]] * 200) for seq in range(0, 60, 4)]

    got = answers(paths, replan_every=180, settle=36)

    assert [a.first_seq for a in got if a] == [37]


def test_a_plan_waits_again_after_a_gap_longer_than_that() -> None:
    seqs = [*range(0, 40, 4), *range(400, 460, 4), *range(480, 640, 4)]
    paths = [scanpath(seq, [[0, 0, 9, 9]] * 200) for seq in seqs]

    got = answers(paths, replan_every=180, settle=36)

    assert [a.first_seq for a in got if a] == [37, 437, 617]


def test_a_successor_waits_no_longer_than_its_predecessor_would_have() -> None:
    paths = [scanpath(seq, [[0, 0, 9, 9]] * 200) for seq in range(0, 44, 4)]
    first, second = Dispatch(DispatchSettings(settle=36)), Dispatch(DispatchSettings(settle=36))
    first.open()
    for path in paths[:9]:
        assert first.on_scanpath(path) is None

    second.open()
    second.restore(first.state())

    assert second.on_scanpath(paths[9]) is not None


def test_every_scanpath_is_a_plan_by_default() -> None:
    got = answers([scanpath(seq, [[0, 0, 9, 9]]) for seq in range(3)])

    assert [a.first_seq for a in got if a] == [1, 2, 3]


def test_hold_repeats_the_window_before_also_across_plans() -> None:
    first = scanpath(0, [[298, 178, 302, 182], [98, 58, 102, 62], NONE])
    second = scanpath(2, [NONE, [float("nan")] * 4])

    one, two = answers([first, second], fill="hold")

    assert one is not None
    assert two is not None
    assert one.windows.tolist() == [[240, 144, 320, 192], [60, 36, 140, 84], [60, 36, 140, 84]]
    assert two.windows.tolist() == [[60, 36, 140, 84]] * 2


def test_hold_begins_in_the_middle() -> None:
    (got,) = answers([scanpath(0, [NONE])], fill="hold")

    assert got is not None
    assert got.windows.tolist() == [CENTRE]


def test_centre_looks_at_the_middle() -> None:
    (got,) = answers([scanpath(0, [[0, 0, 9, 9], NONE])], fill="centre")

    assert got is not None
    assert got.windows.tolist() == [[0, 0, 80, 48], CENTRE]


def test_scan_tours_the_field_by_frame_number() -> None:
    (got,) = answers([scanpath(0, [NONE] * 16)], fill="scan")

    assert got is not None
    assert len({tuple(w) for w in got.windows.tolist()}) == 16
    assert got.windows[0].tolist() == [80, 0, 160, 48]  # frame 1


def test_a_new_stream_discards_the_plan() -> None:
    paths = [
        scanpath(100, [[0, 0, 9, 9]] * 16),
        scanpath(0, [NONE], stream="opened again"),
    ]

    (_, got) = answers(paths, replan_every=8)

    assert got is not None
    assert got.windows.tolist() == [CENTRE]


def test_a_successor_continues_with_the_plan_of_its_predecessor() -> None:
    old, new = (Dispatch(DispatchSettings(replan_every=8)) for _ in range(2))
    old.open()
    new.open()
    old.on_scanpath(scanpath(0, [[98, 58, 102, 62]] * 16))

    new.restore(old.state())

    assert new.on_scanpath(scanpath(4, [NONE])) is None
    later = new.on_scanpath(scanpath(8, [NONE]))
    assert later is not None
    assert later.windows.tolist() == [[60, 36, 140, 84]]


@given(
    box=st.lists(st.floats(width=32), min_size=4, max_size=4),
    size=st.tuples(st.integers(64, 16_320), st.integers(64, 9_184)),
    step_px=st.integers(1, 32),
    fill=st.sampled_from(["hold", "centre", "scan"]),
)
@example(box=[3e38, 0, 3.2e38, 1], size=(320, 192), step_px=4, fill="hold")
def test_any_box_becomes_a_window_the_sensor_can_address(
    box: list[float], size: tuple[int, int], step_px: int, fill: Any
) -> None:
    grid = Geometry(
        width_px=size[0], height_px=size[1], roi_width_px=48, roi_height_px=32, step_px=step_px
    )
    boxes = np.array([box], np.float32)
    (window,) = plan_windows(boxes, 1, grid, fill=fill, held=(0, 0, 48, 32)).tolist()

    assert_addressable(tuple(window), grid)


@given(delay=st.integers(0, 40), every=st.integers(1, 24), horizon=st.integers(1, 40))
def test_coverage_is_what_counting_frames_gives(delay: int, every: int, horizon: int) -> None:
    plans = range(0, 101 * every, every)
    covered = 0
    frames = range(100 * every + 1, 101 * every + 1)
    for k in frames:
        in_force = [j for j in plans if j + delay < k]
        covered += any(k <= j + horizon for j in in_force)

    assert coverage(delay, every, horizon) == pytest.approx(covered / len(frames))


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"replan_every": 0}, "replan_every: must be at least 1, got 0"),
        ({"settle": -1}, "settle: must be at least 0, got -1"),
        ({"fill": "guess"}, "fill: expected hold, centre or scan, got guess"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        DispatchSettings(**settings)
