"""Frames of delay: against counted exposures, against plans that are too short, unknown plans."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.forecast import Forecast
from pipeline.graph.plan import Edge, Node, Plan
from pipeline.planner.delay_plan import DelayPlan, Measured, delay_plans, doubted, late, refused

NODE = {"operator": "tests.samples:Ticker", "settings": {}}


def loop(clock: str = "realtime") -> Plan:
    """Return a plan of two nodes, one of which commands the other."""
    edge = Edge(
        index=0, source="steer", output="out", target="eye", input="schedule", keep="latest",
        depth=1, join=False, optional=True, wait_ms=0, max_age_ms=0, stale="drop", command=True,
        tap=False, transport="pool",
    )  # fmt: skip
    names = ("eye", "steer")
    nodes = tuple(Node(index=i, name=name, **NODE) for i, name in enumerate(names))  # type: ignore[arg-type]
    return Plan(name="loop", clock=clock, nodes=nodes, edges=(edge,))  # type: ignore[arg-type]


def delay(
    horizon: int = 16, replan: int = 1, *, clock: str = "realtime",
    latency_ms: tuple[float, float] | None = None, same_sensor: bool = True, **sensor: float,
) -> DelayPlan:  # fmt: skip
    told = {
        "eye": Forecast(**{"rate_hz": 30, "lead_frames": 1, **sensor}),  # type: ignore[arg-type]
        "steer": Forecast(horizon_frames=horizon, replan_frames=replan),
    }
    run = None
    if latency_ms is not None:
        times = dict(zip(("p50", "p99"), latency_ms, strict=True))
        run = Measured(latency_ms=times, rate_hz=30, same_sensor=same_sensor)
    (found,) = delay_plans(loop(clock), told, run)
    return found


@given(wait=st.integers(0, 5000), lead=st.integers(1, 80))
def test_the_delay_is_the_number_of_exposures_that_a_command_misses(wait: int, lead: int) -> None:
    arrives = Fraction(wait, 10)  # frames after the one that the command was made from
    missed = [k for k in range(1, 600) if k < arrives or k < lead]

    assert late(wait / 10, lead) == len(missed)


def test_plans_shorter_than_the_read_out_are_refused_with_the_figures() -> None:
    found = delay(16, readout_frames=28.7)

    assert list(refused(found)) == [
        "steer: delay: expected plans of more than 28 frames, which is the delay (of the sensor "
        "alone), got 16: every plan arrives too late"
    ]


def test_the_plans_of_the_paper_outlast_its_delay_but_leave_frames_undirected() -> None:
    found = delay(200, 180, latency_ms=(1990.0, 2000.0))  # 60 frames of 33 ms

    assert [row.frames for row in found.rows] == [0, 59, 59]
    assert not list(refused(found))
    (said,) = doubted(found)
    assert said == (
        "steer: delay: 59 frames (loop p99 2000 ms), and plans of 200 frames, a new one every "
        "180, allow 20: 78% of the frames have a plan"
    )


def test_a_plan_that_arrives_within_its_slack_leaves_no_frame_without_one() -> None:
    found = delay(16, 8, latency_ms=(100.0, 300.0))

    assert [row.coverage for row in found.rows] == [1.0, 1.0, 1.0]
    assert not [*refused(found), *doubted(found)]


def test_of_a_sensor_that_records_bursts_only_their_frames_need_a_plan() -> None:
    prototype = delay(200, 180, latency_ms=(1990.0, 2000.0), burst_frames=105)
    slower = delay(200, 180, latency_ms=(1990.0, 4000.0), burst_frames=105)

    assert not [*refused(prototype), *doubted(prototype)]
    assert list(doubted(slower)) == [
        "steer: delay: 119 frames (loop p99 4000 ms), and plans of 200 frames, for a burst of 105, "
        "allow 95: 77% of the frames have a plan"
    ]


def test_a_rare_late_plan_is_a_warning_and_a_usual_one_is_refused() -> None:
    rare, usual = delay(4, latency_ms=(40, 900)), delay(4, latency_ms=(900, 900))

    assert not list(refused(rare))
    assert len(list(doubted(rare))) == 1
    assert "loop p50 900 ms" in next(refused(usual))


def test_the_read_out_is_added_to_a_latency_that_another_sensor_was_measured_with() -> None:
    same = delay(99, latency_ms=(1000, 1000), readout_frames=10)
    other = delay(99, latency_ms=(1000, 1000), readout_frames=10, same_sensor=False)

    assert (same.rows[1].frames, other.rows[1].frames) == (29, 39)


def test_in_lockstep_only_the_sensor_delays() -> None:
    found = delay(clock="lockstep", latency_ms=(900, 900), lead_frames=3)

    assert [(row.of, row.frames) for row in found.rows] == [("sensor", 2)]


@pytest.mark.parametrize("plans", [(0, 1), (16, 0)])
def test_plans_of_unknown_length_are_neither_refused_nor_doubted(plans: tuple[int, int]) -> None:
    found = delay(*plans, latency_ms=(9000, 9000))

    assert found.rows[0].coverage is None
    assert not list(doubted(found))
    assert bool(list(refused(found))) == (plans[0] > 0)


def test_the_delay_of_a_sensor_that_states_none_is_not_known() -> None:
    found = delay(lead_frames=0, latency_ms=(40, 40))

    assert [(row.frames, row.coverage) for row in found.rows] == [(None, None), (1, 1.0), (1, 1.0)]
    assert not [*refused(found), *doubted(found)]
