"""The checks of a sensor's contract find each way of breaking it, and say what they expected."""

import pytest

from drivers.contract import (
    CHECKS,
    SKIPPED,
    Check,
    ContractBroken,
    check_addressable,
    check_an_exposure_without_memory_is_spent,
    check_closing_is_safe_after_any_outcome,
    check_commands_shape_the_frames_they_name,
    check_each_opening_is_a_new_stream,
    check_frames_say_what_they_show,
    check_late_and_foreign_commands_are_counted,
    check_pictures_lie_in_the_memory_lent,
    check_windows_of_any_kind_become_windows_of_the_roi,
)
from drivers.simulated import SimulatedSensor, SimulatedSensorSettings
from pipeline.messages import Geometry
from tests.drivers.attached import wrong_sensors as wrong

SQUARE = SimulatedSensorSettings(scene="tests.drivers.moving_square:MovingSquare")


@pytest.mark.parametrize(
    ("sensor", "check", "said"),
    [
        (wrong.SameNumber, check_frames_say_what_they_show,
         "seq of the second frame: expected 1, got 0"),
        (wrong.SamePicture, check_frames_say_what_they_show,
         "context: expected pictures that differ, got two equal ones"),
        (wrong.Stretched, check_frames_say_what_they_show, "size of the ROI's window: expected"),
        (wrong.SameStream, check_each_opening_is_a_new_stream, "stream: expected another one"),
        (wrong.Disobedient, check_commands_shape_the_frames_they_name,
         "window, command and status 0 after the first commanded frame: expected"),
        (wrong.Disobedient, check_windows_of_any_kind_become_windows_of_the_roi,
         r"command of the frame for \(-500, -500, -400, -400\): expected 0, got -1"),
        (wrong.Uncounted, check_late_and_foreign_commands_are_counted,
         "commands: expected {'accepted': 1, 'late': 1, 'foreign': 1}, got"),
        (wrong.Hoarding, check_an_exposure_without_memory_is_spent,
         "read: expected PoolExhausted from the loan, got an exposure"),
        (wrong.Copying, check_pictures_lie_in_the_memory_lent,
         "roi: expected the memory that was lent, got other memory"),
        (wrong.Restless, check_closing_is_safe_after_any_outcome,
         "read after stop: expected None, got an exposure"),
    ],
)  # fmt: skip
def test_what_is_broken_is_found_and_said(
    sensor: type[SimulatedSensor], check: Check, said: str
) -> None:
    with pytest.raises(ContractBroken, match=said):
        check(lambda: sensor(SQUARE))


def test_each_check_fails_for_some_sensor_here_and_a_sound_one_passes_all() -> None:
    for check in CHECKS:
        assert SKIPPED not in check(lambda: SimulatedSensor(SQUARE))


def test_a_sensor_that_reads_no_region_is_not_asked_for_one() -> None:
    spatial = SimulatedSensorSettings(
        scene="tests.drivers.moving_square:MovingSquare", strategy="spatial"
    )

    for check in (
        check_commands_shape_the_frames_they_name,
        check_windows_of_any_kind_become_windows_of_the_roi,
    ):
        assert check(lambda: SimulatedSensor(spatial)) == {SKIPPED: "it reads no region"}


@pytest.mark.parametrize(
    "window", [(-2, 0, 14, 12), (50, 0, 66, 12), (0, 38, 16, 50), (1, 0, 17, 12)]
)
def test_a_window_off_the_grid_is_refused(window: tuple[int, int, int, int]) -> None:
    grid = Geometry(width_px=64, height_px=48, roi_width_px=16, roi_height_px=12, step_px=2)

    with pytest.raises(ContractBroken, match="window of the ROI: expected one within 64x48"):
        check_addressable(window, grid)
