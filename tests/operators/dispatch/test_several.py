"""Several windows of one exposure: the best of what the scanpath expects, under a budget."""

from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.capture import CaptureSettings
from operators.dispatch import Dispatch, DispatchSettings
from operators.dispatch.several import Objects, best_windows, expected, grown
from pipeline.boxes import centres, covered_by, roi_window
from pipeline.contract import SOURCE
from pipeline.errors import SettingsError
from pipeline.messages import Geometry, RoiSchedule, Scanpath, Tracks
from pipeline.testing import drive, header
from tests.drivers.contract import assert_addressable

GRID = Geometry(width_px=320, height_px=192, roi_width_px=80, roi_height_px=48, step_px=4)
TINY = Geometry(width_px=12, height_px=9, roi_width_px=4, roi_height_px=3, step_px=1)


def objects(boxes: list[Any], weights: list[float]) -> Objects:
    return Objects(
        boxes=np.array(boxes, np.float32).reshape(-1, 4), weights=np.array(weights, np.float32)
    )


def value(seen: Objects, windows: NDArray[np.int32]) -> float:
    """The weight shown by a set of windows."""
    return float(covered_by(seen.boxes, windows.astype(np.float32)) @ seen.weights)


def addressable(geometry: Geometry) -> list[tuple[int, int, int, int]]:
    """Return every window of a sensor."""
    wide, high, step = geometry.roi_width_px, geometry.roi_height_px, geometry.step_px
    return [
        (x, y, x + wide, y + high)
        for x in range(0, geometry.width_px - wide + 1, step)
        for y in range(0, geometry.height_px - high + 1, step)
    ]


@st.composite
def crowds(draw: Any, width_px: int, height_px: int, most: int) -> Objects:
    """Up to `most` boxes in a field, of any weight."""
    count = draw(st.integers(1, most))
    boxes = []
    for _ in range(count):
        x, y = draw(st.integers(0, width_px - 1)), draw(st.integers(0, height_px - 1))
        right, bottom = draw(st.integers(x + 1, width_px)), draw(st.integers(y + 1, height_px))
        boxes.append((x, y, right, bottom))
    weights = draw(st.lists(st.floats(0.0625, 1, width=32), min_size=count, max_size=count))
    return objects(boxes, weights)


@settings(max_examples=60, deadline=None)
@given(seen=crowds(12, 9, 5), step_px=st.sampled_from([1, 2]))
def test_the_first_window_is_the_best_of_all(seen: Objects, step_px: int) -> None:
    grid = Geometry(width_px=12, height_px=9, roi_width_px=4, roi_height_px=3, step_px=step_px)
    windows = np.array(addressable(grid), np.int32)

    found = best_windows(seen, grid, 1)

    best = max(value(seen, window[None]) for window in windows)
    assert value(seen, found) == pytest.approx(best, rel=1e-4, abs=1e-4)


@settings(max_examples=12, deadline=None)
@given(seen=crowds(8, 6, 5))
def test_two_windows_reach_the_share_of_the_optimum_that_greedy_promises(seen: Objects) -> None:
    grid = Geometry(width_px=8, height_px=6, roi_width_px=3, roi_height_px=2, step_px=1)
    pairs = combinations_with_replacement(addressable(grid), 2)
    optimum = max(value(seen, np.array(pair, np.int32)) for pair in pairs)

    found = best_windows(seen, grid, 2)

    assert (1 - 1 / np.e) * optimum - 1e-4 <= value(seen, found) <= optimum + 1e-4


@settings(max_examples=60, deadline=None)
@given(
    seen=crowds(320, 192, 12),
    count=st.integers(1, 4),
    step_px=st.integers(1, 16),
)
def test_windows_lie_on_the_sensors_grid_and_each_shows_something_new(
    seen: Objects, count: int, step_px: int
) -> None:
    grid = Geometry(width_px=320, height_px=192, roi_width_px=80, roi_height_px=48, step_px=step_px)

    found = best_windows(seen, grid, count)

    values = [value(seen, found[:k]) for k in range(len(found) + 1)]
    assert 1 <= len(found) <= count
    assert np.diff(values).min() > 0
    for window in found.tolist():
        assert_addressable(tuple(window), grid)
    assert np.array_equal(best_windows(seen, grid, count), found)


@settings(max_examples=60, deadline=None)
@given(x=st.floats(-20, 340), y=st.floats(-20, 210), side=st.floats(1, 20))
def test_one_window_for_one_object_is_that_of_a_single_roi(x: float, y: float, side: float) -> None:
    box = np.array([[x - side, y - side, x + side, y + side]], np.float32)
    inside = grown(box, 0, GRID)
    if (inside[0, 2:] <= inside[0, :2]).any():
        return  # it is outside the field

    found = best_windows(Objects(boxes=inside, weights=np.ones(1, np.float32)), GRID, 1)

    assert found.tolist() == [list(roi_window(centres(inside[0]), GRID))]


def test_what_is_shown_already_counts_nothing() -> None:
    seen = objects([(10, 10, 20, 20), (24, 10, 34, 20), (200, 100, 210, 110)], [0.5, 0.4, 0.1])

    found = best_windows(seen, GRID, 4)

    assert len(found) == 2  # one shows the first two
    assert covered_by(seen.boxes, found.astype(np.float32)).tolist() == [1, 1, 1]


def test_a_window_that_gains_too_little_is_not_read() -> None:
    seen = objects([(10, 10, 20, 20), (200, 100, 210, 110)], [0.9, 0.1])

    assert len(best_windows(seen, GRID, 2, least_gain=0.2)) == 1
    assert len(best_windows(objects([], []), GRID, 2)) == 0


def scanpath(seq: int, choice: int, box: Any, believed: dict[int, float]) -> Scanpath:
    """Return a plan of two frames that looks at `choice` in `box`."""
    return Scanpath(
        header=header(seq, geometry=GRID),
        ids=np.array(list(believed), np.int32),
        probability=np.array([list(believed.values())] * 2, np.float32),
        choice=np.full(2, choice, np.int32),
        boxes=np.array([box] * 2, np.float32),
        first_seq=seq + 1,
    )


def tracks(seq: int, boxes: dict[int, Any]) -> Tracks:
    """Return tracks that move 10 px to the right in each of four predicted frames."""
    n = len(boxes)
    here = np.array(list(boxes.values()), np.float32).reshape(n, 1, 4)
    step = np.array([10, 0, 10, 0], np.float32)
    return Tracks(
        header=header(seq, geometry=GRID),
        ids=np.array(list(boxes), np.int32),
        labels=np.zeros(n, np.int32),
        scores=np.ones(n, np.float32),
        boxes=here,
        visible=np.ones((n, 1), np.bool_),
        features=np.zeros((n, 1, 0), np.float32),
        predicted=here + np.arange(1, 5, dtype=np.float32)[:, None] * step,
    )


def test_other_objects_are_expected_where_their_tracks_predict_them() -> None:
    path = scanpath(6, 3, (50, 50, 60, 60), {3: 0.7, 5: 0.2})
    seen = expected(path, 1, tracks(5, {3: (0, 0, 9, 9), 5: (100, 20, 110, 30)}), 0.1)

    # row 1 is frame 8, the third after the tracks' own
    assert seen.boxes.tolist() == [[50, 50, 60, 60], [130, 20, 140, 30]]
    assert seen.weights.tolist() == pytest.approx([0.8, 0.3])


def test_a_position_weighs_what_no_object_has() -> None:
    path = scanpath(6, -1, (50, 50, 60, 60), {5: 0.25})
    seen = expected(path, 0, tracks(6, {5: (100, 20, 110, 30)}), 0.0)

    assert dict(zip(seen.boxes[:, 0].tolist(), seen.weights.tolist(), strict=True)) == {
        110.0: 0.25, 50.0: 0.75,
    }  # fmt: skip


def planned(*messages: Any, **values: Any) -> RoiSchedule:
    """Return the last schedule of dispatch."""
    found = [m for m in drive(Dispatch, messages, values) if m is not None]
    assert isinstance(found[-1], RoiSchedule)
    return found[-1]


FAR = {3: (50, 50, 60, 60), 5: (200, 20, 210, 30)}


def test_dispatch_plans_a_window_for_each_object_that_is_worth_one() -> None:
    path = scanpath(6, 3, (60, 50, 70, 60), {3: 0.7, 5: 0.2})

    schedule = planned({"tracks": tracks(6, FAR)}, path, windows=3)

    assert schedule.windows.shape == (2, 3, 4)
    assert schedule.windows[0, 0].tolist() == list(roi_window(np.array([65, 55]), GRID))
    assert schedule.windows[0, 1].tolist() == list(roi_window(np.array([215, 25]), GRID))
    assert not schedule.windows[:, 2].any()  # nothing is left to show


def test_rows_may_share_their_windows() -> None:
    path = scanpath(6, 3, (60, 50, 70, 60), {3: 0.7, 5: 0.2})

    schedule = planned({"tracks": tracks(6, FAR)}, path, windows=2, choose_every=2)

    assert schedule.windows[0].tolist() == schedule.windows[1].tolist()


def test_without_tracks_the_choice_alone_is_looked_at() -> None:
    schedule = planned(scanpath(6, 3, (60, 50, 70, 60), {3: 0.7, 5: 0.2}), windows=2)

    assert schedule.windows[0, 0].tolist() == list(roi_window(np.array([65, 55]), GRID))
    assert not schedule.windows[:, 1].any()


def test_without_any_object_the_first_window_is_filled_as_a_single_one() -> None:
    nothing = scanpath(6, -1, (0, 0, 0, 0), {})

    schedule = planned(nothing, windows=2, fill="centre")

    assert schedule.windows[0].tolist() == [[120, 72, 200, 120], [0, 0, 0, 0]]


def test_one_window_with_a_weight_for_others_is_a_schedule_of_single_windows() -> None:
    path = scanpath(6, 3, (60, 50, 70, 60), {3: 0.7, 5: 0.2})

    schedule = planned({"tracks": tracks(6, FAR)}, path, others=0.1)

    assert schedule.windows.shape == (2, 4)


def test_one_window_alone_is_chosen_as_before_whatever_tracks_there_are() -> None:
    path = scanpath(6, 3, (60, 50, 70, 60), {3: 0.1, 5: 0.9})

    usual, beside = planned(path), planned({"tracks": tracks(6, FAR)}, path)

    assert np.array_equal(usual.windows, beside.windows)


def test_tracks_of_another_stream_are_forgotten() -> None:
    subject = Dispatch(DispatchSettings(windows=2))
    subject.open()
    subject.on_tracks(tracks(6, FAR))
    subject.on_stream(header(0, stream="opened again"))

    schedule = subject.on_scanpath(scanpath(6, 3, (60, 50, 70, 60), {3: 0.7, 5: 0.2}))

    assert schedule is not None
    assert not schedule.windows[:, 1].any()


@pytest.mark.parametrize(("rois", "accepted"), [(1, False), (2, True)])
def test_more_windows_than_the_sensor_reads_are_refused_before_the_start(
    rois: int, accepted: bool
) -> None:
    options = {"scene": "soccer", "rois": rois, "roi_area": 0.03125}
    upstream = {SOURCE: CaptureSettings(options=options), "tracks": None}

    def advise() -> list[str]:
        return list(Dispatch.advise(DispatchSettings(windows=2), upstream))

    if accepted:
        assert advise() == []
        return
    with pytest.raises(SettingsError, match=r"windows: expected at most 1, as many as .*, got 2"):
        advise()


def test_a_graph_without_tracks_is_warned() -> None:
    (said,) = Dispatch.advise(DispatchSettings(windows=2), {})

    assert said.startswith("warning: without the input tracks")


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"windows": 0}, "windows: expected 1 to 4, got 0"),
        ({"windows": 5}, "windows: expected 1 to 4, got 5"),
        ({"others": -0.1}, "others: expected 0 to 1000, got -0.1"),
        ({"margin": float("nan")}, "margin: expected 0 to 1000, got nan"),
        ({"choose_every": 0}, "choose_every: must be at least 1, got 0"),
    ],
)
def test_wrong_settings_are_refused(values: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        DispatchSettings(**values)
