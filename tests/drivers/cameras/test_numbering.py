"""Numbers of exposures: gaps are as wide as the time they lasted."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.cameras.numbering import ExposureNumbers

MS = 1_000_000


def numbered(
    stamps_ms: list[int], *, rate_hz: float = 0.0, skipped: int = 0, realtime: bool = True
) -> tuple[list[int], ExposureNumbers]:
    """Numbers of frames with these stamps, each asked for in time."""
    numbers = ExposureNumbers(rate_hz, realtime=realtime)
    made = []
    for ms in stamps_ms:
        stamp_ns = 1_000_000 * MS + ms * MS
        asked_ns = min(stamp_ns, numbers.due_ns() or stamp_ns)
        made.append(numbers.number(stamp_ns=stamp_ns, skipped=skipped, asked_ns=asked_ns))
    return made, numbers


def test_frames_of_a_camera_are_numbered_one_by_one() -> None:
    made, numbers = numbered([0, 33, 67, 100, 180, 200])

    assert made == [0, 1, 2, 3, 4, 5]
    assert (numbers.late, numbers.missing, numbers.elapsed) == (0, 0, 6)


def test_frames_that_nobody_got_are_numbers_that_are_left_out_as_late() -> None:
    made, numbers = numbered([0, 100, 200], skipped=2)

    assert made == [0, 3, 6]
    assert (numbers.late, numbers.missing) == (4, 0)


def test_an_outage_leaves_out_as_many_numbers_as_frames_would_have_come() -> None:
    made, numbers = numbered([*range(0, 1000, 40), 3960, 4000])

    assert made == [*range(25), 99, 100]
    assert (numbers.late, numbers.missing) == (0, 74)


def test_a_slow_camera_has_no_outages() -> None:
    made, _ = numbered([0, 3000, 6000, 9500, 12000])

    assert made == [0, 1, 2, 3, 4]


def test_with_a_rate_the_number_follows_from_the_stamp() -> None:
    made, numbers = numbered([0, 95, 200, 310, 800, 900], rate_hz=10)

    assert made == [0, 1, 2, 3, 8, 9]
    assert (numbers.late, numbers.missing) == (0, 4)


def test_with_a_rate_an_exposure_is_late_when_it_was_asked_for_too_late() -> None:
    numbers = ExposureNumbers(10.0, realtime=True)
    numbers.number(stamp_ns=1, skipped=0, asked_ns=1)

    seq = numbers.number(stamp_ns=451 * MS, skipped=12, asked_ns=440 * MS)

    assert seq == 4
    assert (numbers.late, numbers.missing) == (3, 0)


def test_lockstep_knows_no_gaps() -> None:
    made, numbers = numbered([0, 5000, 5001, 90_000], skipped=7, realtime=False)

    assert made == [0, 1, 2, 3]
    assert (numbers.late, numbers.missing, numbers.due_ns()) == (0, 0, 0)


@pytest.mark.parametrize("rate_hz", [0.0, 7.0])
@settings(max_examples=40)
@given(
    steps=st.lists(
        st.tuples(st.integers(1, 20_000), st.integers(0, 50), st.integers(0, 5_000)), max_size=40
    )
)
def test_numbers_rise_and_account_for_every_exposure(
    rate_hz: float, steps: list[tuple[int, int, int]]
) -> None:
    numbers = ExposureNumbers(rate_hz, realtime=True)
    stamp_ns, made = 1, []
    for step_ms, skipped, wait_ms in steps:
        stamp_ns += step_ms * MS
        asked_ns = stamp_ns - wait_ms * MS
        made.append(numbers.number(stamp_ns=stamp_ns, skipped=skipped, asked_ns=asked_ns))

    assert made == sorted(set(made))
    assert numbers.elapsed == len(made) + numbers.late + numbers.missing
