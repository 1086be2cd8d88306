"""The command table: the command that sets the window of a frame."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.commands import MOST_SCHEDULES, CommandTable, Window
from drivers.scan import scan_window
from pipeline.messages import Geometry
from tests.drivers.contract import assert_addressable, command

GRID = Geometry(width_px=320, height_px=192, roi_width_px=80, roi_height_px=48, step_px=4)
HELD: Window = (0, 0, 80, 48)


def at(column: int) -> Window:
    return (column * 4, 0, column * 4 + 80, 48)


def test_the_newest_command_wins_even_when_it_arrives_first() -> None:
    table = CommandTable("s", GRID)
    table.accept(command("s", made_from=4, first=5, windows=[at(1)] * 4))
    table.accept(command("s", made_from=2, first=3, windows=[at(2)] * 8))

    assert table.look_up(5, held=HELD).window == at(1)


def test_frames_outside_the_newest_command_use_the_next_newest() -> None:
    table = CommandTable("s", GRID)
    table.accept(command("s", made_from=0, first=1, windows=[at(2)] * 8))
    table.accept(command("s", made_from=3, first=4, windows=[at(1)] * 2))

    assert [table.look_up(k, held=HELD).window for k in range(3, 8)] == [
        at(2), at(1), at(1), at(2), at(2),
    ]  # fmt: skip


def test_a_correction_made_from_the_same_frame_replaces_the_first() -> None:
    table = CommandTable("s", GRID)
    table.accept(command("s", made_from=0, first=1, windows=[at(1)]))
    table.accept(command("s", made_from=0, first=1, windows=[at(2)]))

    assert table.look_up(1, held=HELD).window == at(2)


def test_an_empty_schedule_is_ignored_and_not_counted() -> None:
    table = CommandTable("s", GRID)
    schedule = command("s", made_from=0, first=1, windows=[])
    table.accept(schedule)

    assert (table.accepted, table.late, table.foreign) == (0, 0, 0)


def test_a_command_that_ends_within_the_latency_is_late() -> None:
    table = CommandTable("s", GRID, latency_frames=3)
    table.accept(command("s", made_from=0, first=1, windows=[at(1)] * 3))
    table.accept(command("s", made_from=0, first=1, windows=[at(1)] * 4))

    assert (table.accepted, table.late) == (1, 1)


def test_past_schedules_are_dropped_and_the_number_of_pending_ones_is_bounded() -> None:
    table = CommandTable("s", GRID)
    for seq in range(2 * MOST_SCHEDULES):
        table.accept(command("s", made_from=seq, first=10_000, windows=[at(1)]))

    assert len(table._schedules) == MOST_SCHEDULES
    table.look_up(10_001, held=HELD)
    assert table._schedules == []


@given(
    window=st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 4),
    step_px=st.integers(1, 32),
    size=st.tuples(st.integers(64, 16_320), st.integers(64, 9_184)),
)
def test_any_window_ends_up_inside_the_field_aligned_and_of_the_right_size(
    window: Window, step_px: int, size: tuple[int, int]
) -> None:
    grid = Geometry(
        width_px=size[0], height_px=size[1], roi_width_px=40, roi_height_px=24, step_px=step_px
    )
    table = CommandTable("s", grid)
    table.accept(command("s", made_from=0, first=1, windows=[window]))

    assert_addressable(table.look_up(1, held=HELD).window, grid)


@given(
    seq=st.integers(0, 10**9),
    step_px=st.integers(1, 16),
    size=st.tuples(st.integers(64, 16_320), st.integers(64, 9_184)),
)
def test_a_scan_never_leaves_the_field(seq: int, step_px: int, size: tuple[int, int]) -> None:
    grid = Geometry(
        width_px=size[0], height_px=size[1], roi_width_px=50, roi_height_px=30, step_px=step_px
    )

    assert_addressable(scan_window(seq, grid), grid)


def test_a_window_of_another_size_keeps_its_centre() -> None:
    table = CommandTable("s", GRID)
    table.accept(command("s", made_from=0, first=1, windows=[(100, 80, 180, 120)]))

    left, top, right, bottom = table.look_up(1, held=HELD).window
    assert np.allclose([(left + right) / 2, (top + bottom) / 2], [140, 100], atol=GRID.step_px)
