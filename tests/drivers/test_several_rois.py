"""Several windows in one exposure: what is read, counted and refused, by the simulated sensor."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from drivers.commands import CommandTable, Window
from drivers.sensor import EMPTY_WINDOW, Exposure
from drivers.simulated import SimulatedSensor, SimulatedSensorSettings
from pipeline.errors import DriverError, SettingsError
from pipeline.messages import Geometry, Header, RoiSchedule
from tests.drivers.contract import command, memory, read, started
from tests.drivers.moving_square import MovingSquare

SCENE = "tests.drivers.moving_square:MovingSquare"
GRID = Geometry(width_px=320, height_px=192, roi_width_px=40, roi_height_px=24)
HELD: list[Window] = [(0, 0, 40, 24), EMPTY_WINDOW]
LEFT, RIGHT, NEXT = (0, 0, 40, 24), (200, 100, 240, 124), (20, 0, 60, 24)


def sensor(**settings: Any) -> SimulatedSensor:
    values: dict[str, Any] = {"scene": SCENE, "frames": 4, "rois": 3, "roi_area": 1 / 64}
    return SimulatedSensor(SimulatedSensorSettings(**values | settings))


def exposed(rows: Sequence[Sequence[Window]], **settings: Any) -> tuple[SimulatedSensor, Exposure]:
    """Return a closed sensor and its second exposure, commanded by the only row."""
    subject = sensor(**settings)
    started(subject)
    seen = read(subject).header
    subject.set_rois(command(seen.stream, made_from=0, first=1, windows=rows))
    second = read(subject)
    subject.close()
    return subject, second


def test_every_window_shows_its_part_of_the_same_picture() -> None:
    _, shown = exposed([[LEFT, RIGHT, NEXT]])

    source = MovingSquare()
    picture = source.picture(1)
    source.close()
    frames = (shown.roi, *shown.further)
    assert [f.window for f in frames] == [LEFT, RIGHT, NEXT]
    assert all(f.header is shown.header and f.command_seq == 0 for f in frames)
    for frame in frames:
        left, top, right, bottom = frame.window
        assert np.array_equal(frame.pixels, picture[top:bottom, left:right])


def test_a_window_that_equals_another_is_read_and_counted_once() -> None:
    subject, shown = exposed([[LEFT, LEFT, RIGHT]], frames=2)

    assert [f.window for f in shown.further] == [EMPTY_WINDOW, RIGHT]
    assert [f.pixels.size > 0 for f in shown.further] == [False, True]
    summary = subject.summary()
    assert summary["further_windows"] == {"not_commanded": 2, "duplicate": 1, "read": 1}
    context, roi, whole = 80 * 48, 40 * 24, 320 * 192
    used = (2 * context + 3 * roi) / (2 * whole)  # one window, then two
    assert summary["pixels"]["used"] == pytest.approx(used, abs=1e-6)


def test_windows_that_overlap_are_each_read_and_counted() -> None:
    subject, shown = exposed([[LEFT, NEXT, RIGHT]], frames=2)

    assert all(f.pixels.size for f in shown.further)
    assert subject.summary()["further_windows"] == {"not_commanded": 2, "read": 2}


def test_what_two_windows_show_of_a_box_counts_once_in_the_coverage() -> None:
    left, top, right, _ = (int(v) for v in _square(1))
    middle = (left + right) // 2
    halves = [(middle - 40, top, middle, top + 24), (middle, top, middle + 40, top + 24)]

    subject, shown = exposed([[*halves, halves[1]]], frames=2)

    assert shown.further[0].window == halves[1]
    # of the first exposure nothing: the window was in the middle
    assert subject.summary()["roi_coverage"]["ball"] == pytest.approx(0.5)


def test_windows_are_held_without_a_command_and_each_has_its_status() -> None:
    subject = sensor()
    started(subject)
    seen = read(subject)
    rows = [[RIGHT, LEFT]]
    subject.set_rois(command(seen.header.stream, made_from=0, first=1, windows=rows))
    commanded, held = read(subject), read(subject)
    subject.close()

    assert [f.window for f in seen.further] == [EMPTY_WINDOW] * 2  # nothing was asked for
    for exposure, status, made_from in ((commanded, "ok", 0), (held, "unplanned", -1)):
        frames = (exposure.roi, *exposure.further)
        assert [f.window for f in frames] == [RIGHT, LEFT, EMPTY_WINDOW]
        assert {f.status for f in frames} == {status}
        assert {f.command_seq for f in frames} == {made_from}


def test_a_sensor_of_one_window_has_no_further_frames_nor_figures() -> None:
    subject = sensor(rois=1)
    started(subject)
    shown = read(subject)
    subject.close()

    assert shown.further == ()
    assert "further_windows" not in subject.summary()


def test_a_row_of_one_window_is_a_command_of_a_single_roi() -> None:
    _, shown = exposed([[RIGHT]], rois=1)

    assert (shown.roi.window, shown.roi.command_seq) == (RIGHT, 0)


def test_memory_is_lent_for_each_window_by_the_name_of_its_output() -> None:
    names: list[str] = []

    def loan(output: str, *given: Any, **named: Any) -> Any:
        names.append(output)
        return memory(output, *given, **named)

    subject = started(sensor())
    subject.read(loan)
    subject.close()

    assert names == ["context", "roi", "roi_2", "roi_3"]


@pytest.mark.parametrize(
    ("rois", "count", "named"),
    [
        (2, 3, r"schedule: expected 1 to 2 windows .*, got 3"),
        (1, 2, r"schedule: expected 1 window .*, got 2"),
        (1, 0, r"schedule: expected 1 window .*, got 0"),
    ],
)
def test_no_and_more_windows_than_a_sensor_reads_are_refused_with_both_numbers(
    rois: int, count: int, named: str
) -> None:
    table = CommandTable("s", GRID, rois=rois)
    windows = np.zeros((5, count, 4), np.int32)
    schedule = RoiSchedule(
        header=Header(stream="s", seq=0, stamp_ns=0), first_seq=1, windows=windows
    )

    with pytest.raises(DriverError, match=named):
        table.accept(schedule)


def test_windows_without_area_are_not_read_except_the_first() -> None:
    table = CommandTable("s", GRID, rois=2)
    table.accept(command("s", made_from=0, first=1, windows=[[(9, 9, 1, 1), (50, 9, 40, 30)]]))

    first, second = table.look_up_all(1, held=HELD)

    assert first.window[2] - first.window[0] == 40
    assert second.window == EMPTY_WINDOW


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"rois": 0}, "rois: expected 1 to 4, got 0"),
        ({"rois": 5}, "rois: expected 1 to 4, got 5"),
        ({"strategy": "oracle"}, "rois: oracle reads one window at most, .* got 3"),
        ({"roi_area": 0.05}, "budget: context 0.0625 and 3 windows of the ROI 0.15 take 0.2125"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        sensor(**settings)


def test_capabilities_and_forecast_tell_every_window() -> None:
    subject = sensor(size_px=(320, 192), rate_hz=50.0)
    subject.open(realtime=False)
    can, told = subject.capabilities(), subject.forecast()
    subject.close()

    assert can.rois == 3
    assert list(told.streams) == ["context", "roi", "roi_2", "roi_3"]


def _square(index: int) -> np.ndarray[Any, Any]:
    source = MovingSquare()
    box = source.box(index)
    source.close()
    return box
