"""What belongs to a frame is drawn together, in order, and not held for long."""

from hypothesis import given
from hypothesis import strategies as st

from operators.visualise.held import MOST_FRAMES, Held


def drawn(arrivals: list[tuple[int, str]]) -> tuple[list[tuple[int, str]], int]:
    """Bring frames of sources in this order; return what was drawn, and the most frames held."""
    held: Held[tuple[int, str]] = Held()
    found, most = [], 0
    for frame, source in arrivals:
        found += [item for _, items in held.complete() for item in items]
        held.arrived(frame, source)
        held.add(frame, (frame, source))
        most = max(most, len(held._items))
    return found + [item for _, items in held.all() for item in items], most


def test_a_picture_waits_for_the_tracks_of_its_frame():
    held: Held[str] = Held()
    for frame, source in ((0, "context"), (0, "tracks"), (1, "context"), (2, "context")):
        held.arrived(frame, source)
        held.add(frame, f"{source} {frame}")

    first = list(held.complete())
    held.arrived(2, "tracks")
    held.add(2, "tracks 2")

    assert first == [(0, ["context 0", "tracks 0"])]
    assert list(held.complete()) == [(1, ["context 1"]), (2, ["context 2", "tracks 2"])]


def test_a_source_that_sends_nothing_more_is_not_waited_for():
    arrivals = [(0, "tracks"), *((frame, "context") for frame in range(100))]

    _, most = drawn(arrivals)

    assert most <= MOST_FRAMES + 2


@given(st.data())
def test_everything_is_drawn_once_and_in_the_order_of_frames(data):
    frames = {
        source: data.draw(st.lists(st.integers(0, 60), unique=True).map(sorted))
        for source in ("context", "tracks", "schedule")
    }
    arrivals = []
    while any(frames.values()):
        source = data.draw(st.sampled_from([name for name, left in frames.items() if left]))
        arrivals.append((frames[source].pop(0), source))

    found, _ = drawn(arrivals)

    assert sorted(found) == sorted(arrivals)
    for source in frames:
        own = [frame for frame, name in found if name == source]
        assert own == sorted(own)
