"""Threads and providers: the cheapest way that is in time, the fastest where none is."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.planner.thread_plan import SAME, SAME_MS, Way, choose, choose_all, cores_needed

WAYS = st.builds(
    Way,
    threads=st.integers(1, 8),
    provider=st.sampled_from(["", "cpu", "cuda"]),
    wall_ms=st.floats(0.1, 100),
    cpu_ms=st.floats(0.1, 100),
)


def way(wall_ms: float, cpu_ms: float, threads: int = 1) -> Way:
    return Way(threads=threads, provider="cpu", wall_ms=wall_ms, cpu_ms=cpu_ms)


@given(WAYS, st.lists(WAYS, max_size=6), st.floats(1, 200))
def test_a_choice_is_in_time_where_anything_is_and_nothing_in_time_is_much_cheaper(
    now: Way, ways: list[Way], rate_hz: float
) -> None:
    found = choose(now, ways, rate_hz)

    tried, period_ms = [now, *ways], 1000 / rate_hz
    assert found.chosen in tried
    assert found.in_time == any(each.wall_ms <= period_ms for each in tried)
    if found.in_time:
        assert found.chosen.wall_ms <= period_ms
        least = min(each.cpu_ms for each in tried if each.wall_ms <= period_ms)
        assert found.chosen.cpu_ms <= least + max(SAME_MS, SAME * least)
    else:
        assert found.chosen.wall_ms == min(each.wall_ms for each in tried)


def test_what_the_graph_has_stays_where_little_is_saved() -> None:
    now, other = way(20, 10.3), way(20, 10.0, 2)

    assert not choose(now, [other], 30).changed
    assert choose(way(20, 12), [other], 30).chosen is other


def test_more_threads_are_taken_only_for_the_rate() -> None:
    one, two = way(20, 18), way(11, 21, 2)

    assert choose(one, [two], 30).chosen is one
    assert choose(one, [two], 60).chosen is two


def test_the_cores_are_those_of_all_that_is_done_in_a_frame() -> None:
    kept = choose(way(20, 15), [], 30)

    assert round(cores_needed(5, {"a": kept, "b": kept}, 30), 6) == 1.05


@pytest.mark.parametrize(("cores", "threads", "in_time"), [(4.0, 2, True), (2.0, 1, False)])
def test_a_faster_way_that_costs_more_is_chosen_only_where_the_cores_suffice_for_all(
    cores: float, threads: int, in_time: bool
) -> None:
    now = Way(threads=1, provider="", wall_ms=38.0, cpu_ms=35.0)
    faster = Way(threads=2, provider="", wall_ms=32.0, cpu_ms=41.0)

    choice = choose_all({"saliency": (now, [faster])}, 60.0, 30.0, cores)["saliency"]

    assert choice.chosen.threads == threads
    assert choice.in_time == in_time
