"""Stamps of a camera's clock become stamps of this host's."""

from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.camera import gap
from drivers.genicam.clock import FRAMES, CameraClock

PERIOD_NS = 10_000_000
DELAYS = st.lists(st.integers(0, 50_000_000), min_size=2, max_size=80)


@given(delays=DELAYS, epoch_ns=st.integers(1, 1 << 60), began_ns=st.integers(1, 1 << 60))
def test_stamps_ascend_by_the_cameras_clock_once_a_frame_came_at_once(
    delays: list[int], epoch_ns: int, began_ns: int
) -> None:
    clock, told = CameraClock(), []
    for i, delay_ns in enumerate(delays):
        arrived_ns = began_ns + i * PERIOD_NS + delay_ns
        told.append((clock.monotonic_ns(epoch_ns + i * PERIOD_NS, arrived_ns), arrived_ns))

    stamps = [stamp for stamp, _ in told]
    assert stamps == sorted(set(stamps))
    least = min(delays)
    best = delays.index(least)
    for i, stamp_ns in list(enumerate(stamps))[best:]:
        behind_ns = stamp_ns - (began_ns + i * PERIOD_NS)
        assert behind_ns == least or stamp_ns == stamps[i - 1] + 1


def test_a_camera_without_a_clock_is_stamped_at_arrival() -> None:
    clock = CameraClock()

    assert [clock.monotonic_ns(0, arrived) for arrived in (50, 90)] == [50, 90]


def test_a_clock_that_does_not_count_nanoseconds_is_not_trusted() -> None:
    clock = CameraClock()
    told = [clock.monotonic_ns(1 + i * PERIOD_NS // 8, i * PERIOD_NS + 5) for i in range(200)]

    assert not clock.trusted
    assert told[-1] == 199 * PERIOD_NS + 5


def test_a_clock_that_begins_anew_is_followed() -> None:
    clock = CameraClock()
    clock.monotonic_ns(9_000_000_000, 100)

    assert clock.monotonic_ns(1_000, 5_000) == 5_000
    assert clock.monotonic_ns(2_000, 9_000) == 6_000


def test_a_clock_that_drifts_is_followed_within_the_window() -> None:
    clock, told = CameraClock(), 0
    for i in range(10 * FRAMES):
        told = clock.monotonic_ns(1 + i * PERIOD_NS, i * PERIOD_NS * 10_001 // 10_000)

    now_ns = (10 * FRAMES - 1) * PERIOD_NS * 10_001 // 10_000
    assert 0 <= now_ns - told <= FRAMES * PERIOD_NS // 10_000 + 1


@given(last=st.integers(1, 65_535), step=st.integers(1, 30_000))
def test_frames_left_out_are_counted_across_the_wrap(last: int, step: int) -> None:
    following = (last - 1 + step) % 65_535 + 1

    assert gap(last, following) == step - 1
